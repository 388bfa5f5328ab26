"""Random numbers of a start by (seed, population, quantity, number of the particle), independent of rank and order.

A particle has the same numbers however many others there are, and on any rank: each rank draws those of its own particles only. A
change of the radii of one population leaves its velocities, and all other populations, as they were. Most quantities take few
numbers for each particle, and use numpy's generators, one for each block of particles. A particle that looks for a free place may
need any number of points: those come from a hash of (particle, try, axis).
"""

from collections.abc import Callable
from zlib import crc32

import numpy as np

from particles_mpi.kernels.jit import lean_inner
from particles_mpi.particles import Array, row_dot

GENERATOR_BLOCK = 4096  # particles that have a generator together
STREAMS = {name: k for k, name in enumerate(("position", "velocity", "speed", "radius", "mass", "drag"))}
LOW_HALF = np.uint64(0xFFFFFFFF)
HALF_BITS = np.uint64(32)


def stream_key(seed: int, population: int, quantity: str) -> Array:
    """The two uint64 that key the random numbers of one quantity of one population (by its number) of a scene with this seed."""
    if quantity in STREAMS:
        stream = population * len(STREAMS) + STREAMS[quantity]
    else:
        stream = crc32(f"{population} {quantity}".encode()) << 31
    return np.array([seed, stream], np.uint64)


def draw(key: Array, first: int, last: int, numbers: Callable[[np.random.Generator, int], Array]) -> Array:
    """What `numbers(generator, count)` gives, (count, ...), for the particles first ... last - 1 of a population."""
    parts = []
    for block in range(first // GENERATOR_BLOCK, max(-(-last // GENERATOR_BLOCK), first // GENERATOR_BLOCK + 1)):
        generator = np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, block]))
        begin = block * GENERATOR_BLOCK
        parts.append(numbers(generator, GENERATOR_BLOCK)[max(first - begin, 0) : max(last - begin, 0)])
    return np.concatenate(parts) if len(parts) > 1 else parts[0]


def uniform(generator: np.random.Generator, count: int) -> Array:
    """Numbers (count,) of [0, 1)."""
    return generator.random(count)


def directions(generator: np.random.Generator, count: int, d: int) -> Array:
    """Unit vectors (count, d), no direction preferred."""
    normal = generator.standard_normal((count, d))
    norm = np.sqrt(row_dot(normal, normal))
    return normal / np.where(norm > 0.0, norm, 1.0)[:, None]


@lean_inner
def random_pair(k0, k1, c0, c1, c2, c3):
    """Two numbers of [0, 1) from a key and a counter, all uint64 below 2^32.

    Philox4x32-10: J. Salmon, M. Moraes, R. Dror and D. Shaw, Parallel random numbers: as easy as 1, 2, 3, SC11 (2011).
    """
    for _ in range(10):
        p0, p1 = np.uint64(0xD2511F53) * c0, np.uint64(0xCD9E8D57) * c2
        c0, c1, c2, c3 = (p1 >> HALF_BITS) ^ c1 ^ k0, p1 & LOW_HALF, (p0 >> HALF_BITS) ^ c3 ^ k1, p0 & LOW_HALF
        k0, k1 = (k0 + np.uint64(0x9E3779B9)) & LOW_HALF, (k1 + np.uint64(0xBB67AE85)) & LOW_HALF
    high, low = (c0 << HALF_BITS) | c1, (c2 << HALF_BITS) | c3
    return np.float64(high >> np.uint64(11)) * 2.0**-53, np.float64(low >> np.uint64(11)) * 2.0**-53
