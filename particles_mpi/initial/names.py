"""Particles and pairs as they are named in a fault."""

from __future__ import annotations

from collections.abc import Sequence

from particles_mpi.particles import Array

SHOWN = 5  # particles or pairs named in a fault


def listed(names: Sequence[object] | Array, what: str = "particle") -> str:
    """ "particle 3", "particles 3 and 7", "particles 0, 1, 2, 3, 4 and 12 more"."""
    parts, more = [str(n) for n in names[:SHOWN]], len(names) - SHOWN
    parts += [f"{more} more"] if more > 0 else []
    return f"{what}{'s' if len(names) > 1 else ''} " + (
        parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    )


def pair_names(first: Array, second: Array) -> list[str]:
    return [f"{i}-{j}" for i, j in zip(first.tolist(), second.tolist())]
