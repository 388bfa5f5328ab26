"""What numbers of 32 bits can count: kernels number the rows of a rank, places in lists and cells with them, for speed.

Ids, times, sums over all ranks, and places in files have 64 bits. So N is not limited, but what one rank holds is.
"""

from particles_mpi.errors import StoppedError

MOST = 2**31 - 1


def require_countable(number: int, what: str) -> None:
    """Raise a StoppedError if this rank would have more of something than 32 bits can count: before any number wraps."""
    if number > MOST:
        raise StoppedError(f"{number} {what} on one rank, more than {MOST}: use more ranks")
