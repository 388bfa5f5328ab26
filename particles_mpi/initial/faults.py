"""The faults of a start, collected over the ranks: a line for each fault, the same on all ranks."""

from itertools import chain

from particles_mpi.errors import MOST_NAMED, SceneError, listed
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array


def listed_ids(ranks: Communicator, ids: Array) -> str:
    """The particles that any rank names: the lowest ids, and how many more there are; "" if none. Collective."""
    total = ranks.total(len(ids))[0]
    if not total:
        return ""
    mine = sorted(ids.tolist())[:MOST_NAMED]
    return listed(sorted(chain.from_iterable(ranks.allgather(mine))), total=total)


class Faults:
    """Faults that were `found`, in order."""

    def __init__(self, ranks: Communicator):
        self.ranks = ranks
        self.found: list[str] = []

    def add(self, fault: str) -> None:
        """Add a fault that all ranks found."""
        self.found.append(fault)

    def name(self, before: str, ids: Array, after: str = "") -> None:
        """Add a fault that names particles, if any rank gives some: "before particles 0, 1 and 7 after". Collective."""
        if named := listed_ids(self.ranks, ids):
            self.add(f"{before}{named}{after}")

    def stop(self) -> None:
        """Raise SceneError if there is a fault."""
        if self.found:
            raise SceneError(self.found)
