"""Exact sums over all particles, which have the same bits in any order and on any number of ranks.

A sum is kept as an integer multiple of 2^-1074, in base 2^32 with an int64 for each digit: a BLOCK of numbers is added, then
carries go to the next digit, so that the digits of 2^30 ranks can be added. Integers are added exactly across the ranks, and
the total is rounded once.
"""

from collections.abc import Callable
from contextlib import suppress
from math import fsum, inf, isfinite, nan

import numpy as np

from particles_mpi.kernels.jit import kernel
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array

FEW_VALUES = 256  # values
BLOCK = 2**14  # rows at once: their terms stay in the cache of a core, and no digit overflows, which 2^29 would
MASK = 0xFFFFFFFF
DIGITS = 68  # of 32 bits each, from 2^-1074 to beyond 2^1024; the last one counts values that are not finite


@kernel
def accumulate(values, digits):
    """Add float64 values (n,), a BLOCK at most, exactly to the sum with these digits (DIGITS,) int64. In place.

    In the end all digits but the highest one, which has the sign, are from 0 to 2^32 - 1.
    """
    bits = values.view(np.int64)
    mask = np.int64(MASK)
    for i in range(len(bits)):
        exponent = (bits[i] >> 52) & 0x7FF
        mantissa = bits[i] & 0xFFFFFFFFFFFFF
        if exponent == 0x7FF:
            digits[DIGITS - 1] += 1
            continue
        if exponent > 0:
            mantissa |= np.int64(1) << 52
            exponent -= 1
        digit = exponent >> 5
        shift = exponent & 31
        low = (mantissa & mask) << shift  # below 2^63
        high = (mantissa >> 32) << shift  # below 2^52
        sign = 1 if bits[i] >= 0 else -1
        digits[digit] += sign * (low & mask)
        digits[digit + 1] += sign * ((low >> 32) + (high & mask))
        digits[digit + 2] += sign * (high >> 32)
    for digit in range(DIGITS - 2):
        carry = digits[digit] >> 32
        digits[digit] -= carry << 32
        digits[digit + 1] += carry


def exact_sums(ranks: Communicator, columns: list[Array]) -> list[float]:
    """The sums of the columns (n,) over all ranks, correctly rounded; nan if a value is not finite. Collective: one reduction."""
    sums = exact_sums_by_name(ranks, len(columns[0]), lambda rows: {str(k): c[rows] for k, c in enumerate(columns)})
    return list(sums.values())


def exact_sums_by_name(ranks: Communicator, number: int, terms: Callable[[slice], dict[str, Array]]) -> dict[str, float]:
    """`exact_sums` of terms that are computed for a block of rows at once: whole columns of them need not be held.

    `number`: of this rank's rows; `terms(rows)`: the terms of the rows in that slice, by name. Collective: one reduction.
    """
    if ranks.size == 1 and number <= FEW_VALUES:
        with suppress(OverflowError):  # of a partial sum: the whole may be finite
            return {name: sum_of_few(column) for name, column in terms(slice(0, number)).items()}
    sums: dict[str, Array] = {}
    for begin in range(0, max(number, 1), BLOCK):  # once where there are no rows: for the names
        for name, column in terms(slice(begin, min(begin + BLOCK, number))).items():
            accumulate(np.ascontiguousarray(column, np.float64), sums.setdefault(name, np.zeros(DIGITS, np.int64)))
    total = ranks.allreduce_sum(np.array(list(sums.values())))
    return {name: rounded(row) for name, row in zip(sums, total, strict=True)}


def sum_of_few(column: Array) -> float:
    """The sum of one column, correctly rounded: in a tenth of the time of a sum by digits, for few values."""
    try:
        total = fsum(column.tolist())
    except ValueError:  # infinities of both signs
        return nan
    return total + 0.0 if isfinite(total) else nan  # of negative zeros the sum is 0, as it is of digits


def rounded(digits: Array) -> float:
    """The float64 nearest to the sum that the digits hold."""
    if digits[-1]:
        return nan
    lower, upper = (int.from_bytes(part.astype("<u4").tobytes(), "little") for part in (digits[:-2] & MASK, digits[:-2] >> 32))
    total = lower + (upper << 32) + (int(digits[-2]) << 32 * (DIGITS - 2))  # the sign is that of the highest digit
    try:
        return total / (1 << 1074)
    except OverflowError:
        return inf if total > 0 else -inf
