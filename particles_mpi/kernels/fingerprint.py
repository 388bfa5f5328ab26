"""A number that tells whether an array was changed."""

from typing import Any

import numpy as np

from particles_mpi.kernels.jit import kernel

# 2^64 divided by the golden ratio, as int64, odd: multiplied with it, numbers that differ little differ in many bits (D. Knuth,
# The Art of Computer Programming 3, 6.4).
GOLDEN = -7046029254386353131


@kernel
def fingerprint(x):
    """A hash of the bits of x (n, d) float64: it is another number (but for one case in 2^64) when any of them changes."""
    total = np.int64(0)
    for number in x.reshape(-1).view(np.int64):
        total = (total ^ number) * np.int64(GOLDEN)
        total ^= total >> 29
    return total


def places_of(particles: Any) -> tuple[int, ...]:
    """(version, edition, fingerprint) of `Particles`: the same until rows change order, or anything of them changes."""
    return particles.version, particles.edition, fingerprint(particles.position)
