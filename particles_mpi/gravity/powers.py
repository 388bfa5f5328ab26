"""Powers -1/2 and -3/2 by products and sums, which take less time than a root and a quotient, and fill vectors of any length.

A first guess y of r^(-1/2) comes from the bits of r, a polynomial in r y^2 makes it better, and what is then missing,
h = 1 - r y^2, enters by the series of (1 - h)^(-1/2) or (1 - h)^(-3/2), whose next term is below the round-off.
First guess: C. Lomont, Fast Inverse Square Root, Purdue University (2003).

All formulas are for float64, eight of these at once (`Lanes`), and float32: a literal in them is of the kind of the numbers
(`as_kind`).
"""

from typing import Any

from llvmlite import ir
from numba import types

from particles_mpi.kernels.jit import as_kind, fma, inner, intrinsic
from particles_mpi.kernels.lanes import LANES

# Minus half of the bits of a number gives those of its inverse square root, within 3.5 %: for 64 and 32 bits.
HALF_EXPONENT = {types.float64: 0x5FE6EB50C7B537A9, LANES: 0x5FE6EB50C7B537A9, types.float32: 0x5F375A86}
BITS = {types.float64: ir.IntType(64), LANES: ir.VectorType(ir.IntType(64), LANES.width), types.float32: ir.IntType(32)}
# In t, closest to t^-1/2 where that guess can lead: within 8e-7; for float32 within 3e-5, the square of which is below round-off.
CUBIC = (2.18865904, -2.18968855, 1.31340004, -0.31237129)
QUADRATIC = (1.87659833, -1.25210032, 0.3755022)

formula: Any = inner(_nrt=False, error_model="numpy", forceinline=True)


def constant(kind: Any, number: Any) -> Any:
    """The number in the compiler's type, as often as that holds numbers."""
    return ir.Constant(kind, [number] * kind.count if isinstance(kind, ir.VectorType) else number)


@intrinsic
def first_guess(typing: Any, r: Any) -> Any:
    """r^(-1/2) within 3.5 %, from the bits of r, which is not negative."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = BITS[r]
        half = builder.lshr(builder.bitcast(arguments[0], bits), constant(bits, 1))
        return builder.bitcast(builder.sub(constant(bits, HALF_EXPONENT[r]), half), arguments[0].type)

    return r(r), generate


@intrinsic
def if_positive(typing: Any, r: Any, value: Any) -> Any:
    """The value where r is positive, 0 elsewhere."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        zero = constant(arguments[0].type, 0.0)
        return builder.select(builder.fcmp_ordered(">", arguments[0], zero), arguments[1], zero)

    return r(r, r), generate


@intrinsic
def by_kind(typing: Any, r: Any, single: Any, double: Any) -> Any:
    """`single` if r is a float32, `double` if not."""
    return double(r, single, double), lambda context, builder, signature, arguments: arguments[1 if r == types.float32 else 2]


@formula
def almost_inverse_root(r):
    """y, which is r^(-1/2) but for 1e-6 of it, or 3e-5; y^2; and h = 1 - r y^2."""
    guess = first_guess(r)
    t = r * (guess * guess)
    quadratic = fma(fma(as_kind(QUADRATIC[2], r), t, as_kind(QUADRATIC[1], r)), t, as_kind(QUADRATIC[0], r))
    cubic = fma(fma(fma(as_kind(CUBIC[3], r), t, as_kind(CUBIC[2], r)), t, as_kind(CUBIC[1], r)), t, as_kind(CUBIC[0], r))
    y = guess * by_kind(r, quadratic, cubic)
    y2 = y * y
    return y, y2, fma(-r, y2, as_kind(1.0, r))


@formula
def inverse_root(r):
    """r^(-1/2) of a positive number, within 2e-16 of it, or within 1e-7."""
    y, _, h = almost_inverse_root(r)
    half = as_kind(0.5, r)
    return fma(y * h, by_kind(r, half, fma(as_kind(0.375, r), h, half)), y)


@formula
def inverse_cube(r2):
    """1/r2^(3/2), within 4e-16 of it, or within 2e-7; 0 where r2 is 0."""
    return pull(as_kind(1.0, r2), r2)


@formula
def pull(mass, r2):
    """mass/r2^(3/2), as precisely: the mass comes first, so that a small one of a near source is in the range of the numbers."""
    y, y2, h = almost_inverse_root(r2)
    near, first = mass * y * y2, as_kind(1.5, r2)
    return if_positive(r2, fma(near * h, by_kind(r2, first, fma(as_kind(1.875, r2), h, first)), near))
