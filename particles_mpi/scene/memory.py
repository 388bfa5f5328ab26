"""How much memory a run needs, and how much there is."""

import os
from pathlib import Path

from particles_mpi.particles import Array, row_bytes
from particles_mpi.scene.schema import Scene

# Bytes: `python tests/benchmarks/speed.py memory` measures them.
LIBRARIES = 190_000_000  # of a rank: Python, libraries, and compiled kernels
# Of a particle, besides its columns: always, for the start and output; and in addition for candidate pairs, for a tree, and for
# the contacts of a particle in a pile, about nine half-edges at most.
ALWAYS, PAIRS, TREE, PILES = 190, 430, 240, 4200
CGROUPS = Path("/sys/fs/cgroup")


def memory_needed(scene: Scene, columns: dict[str, Array], total: int, ranks: int, piles: bool = True) -> int:
    """Return how many bytes all ranks together need for `total` particles, without ghosts: correct within about a quarter.

    `columns`: the fields of particles, with any number of rows. `piles`: where contacts can last, will all particles come to lie
    in piles?
    """
    row = row_bytes(*columns.values()) + ALWAYS + PAIRS * ("collisions" in scene.active)
    row += PILES * (piles and {"supported", "contacted"} <= columns.keys())
    gravity = scene.active.get("mutual_gravity")
    if gravity and gravity.choice(scene, total).angle is not None:
        row += TREE
    return total * row + ranks * LIBRARIES


def memory_there() -> float:
    """Return how many bytes of memory this machine has, or a container or job on it may use."""
    least = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    for limit in limits_of_groups():
        try:
            said = limit.read_text().strip()
        except OSError:
            continue
        if said.isdigit():  # else "max"
            least = min(least, float(said))
    return least


def limits_of_groups() -> list[Path]:
    """Return the files with memory limits for the control groups of this process, in both versions of Linux's control groups."""
    try:
        groups = [line.split(":", 2) for line in Path("/proc/self/cgroup").read_text().splitlines()]
    except OSError:
        return []
    files = []
    for _, kind, place in groups:
        if kind in ("", "memory"):
            name = "memory.limit_in_bytes" if kind else "memory.max"
            group = CGROUPS / kind / place.lstrip("/")
            files += [folder / name for folder in (group, *group.parents) if folder.is_relative_to(CGROUPS)]
    return files
