"""Powers -1/2 and -3/2 by products and sums, which take less time than a root and a quotient, and fill vectors of any length.

A first guess y of r^(-1/2) comes from the bits of r, a polynomial in r y^2 makes it better, and what is then missing,
h = 1 - r y^2, enters by the series of (1 - h)^(-1/2) or (1 - h)^(-3/2), whose next term is below the round-off.
First guess: C. Lomont, Fast Inverse Square Root, Purdue University (2003).
"""

from typing import Any

import numpy as np

from particles_mpi.kernels.jit import fma, inner

HALF_EXPONENT = 0x5FE6EB50C7B537A9  # minus half of the bits of a number gives those of its inverse square root, within 3.5 %
CUBIC = (2.18865904, -2.18968855, 1.31340004, -0.31237129)  # in t, closest to t^-1/2 where that guess can lead: within 8e-7

formula: Any = inner(_nrt=False, error_model="numpy", forceinline=True)


@formula
def almost_inverse_root(r):
    """y, which is r^(-1/2) but for 1e-6 of it; y^2; and h = 1 - r y^2."""
    guess = np.int64(HALF_EXPONENT - (np.float64(r).view(np.int64) >> 1)).view(np.float64)
    t = r * (guess * guess)
    y = guess * fma(fma(fma(CUBIC[3], t, CUBIC[2]), t, CUBIC[1]), t, CUBIC[0])
    y2 = y * y
    return y, y2, fma(-r, y2, 1.0)


@formula
def inverse_root(r):
    """r^(-1/2) of a positive number, within 2e-16 of it."""
    y, _, h = almost_inverse_root(r)
    return fma(y * h, fma(0.375, h, 0.5), y)


@formula
def pull(mass, r2):
    """mass/r2^(3/2), within 4e-16 of it; 0 where r2 is 0."""
    y, y2, h = almost_inverse_root(r2)
    near = mass * y * y2
    return fma(near * h, fma(1.875, h, 1.5), near) if r2 > 0.0 else 0.0
