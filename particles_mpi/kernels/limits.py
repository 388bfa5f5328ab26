"""What numbers of 32 bits can count: kernels number the rows of a rank, places in lists and cells with them, for speed.

Ids, times, sums over all ranks, and places in files have 64 bits. So N is not limited, but what one rank holds is.
"""

from particles_mpi.errors import StoppedError

INT32_MAX = 2**31 - 1


def require_countable(number: int, what: str) -> None:
    """Raise a StoppedError if this rank would have more of something than 32 bits can count: before any number wraps."""
    if number > INT32_MAX:
        raise StoppedError(f"{number} {what} on one rank, more than {INT32_MAX}: use more ranks")
