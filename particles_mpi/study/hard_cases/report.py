"""Runs the catalogue and prints its table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.table import Table

from particles_mpi.errors import SceneError
from particles_mpi.output.console import Screen
from particles_mpi.parallel.ranks import Ranks
from particles_mpi.study.hard_cases import Case, Outcome, catalogue, examine, settings


def chosen(only: str | None, full: bool) -> list[Case]:
    """The cases whose names hold `only`, or one of several texts with | between; long ones if asked for, by `full` or by name."""
    parts = (only or "").lower().split("|")
    cases = [one for one in catalogue() if any(part in one.name.lower() for part in parts)]
    if not cases:
        raise SceneError(f"--only: no case has {only!r} in its name; there are: " + "; ".join(c.name for c in catalogue()))
    return [one for one in cases if full or only is not None or not one.long]


def study(only: str | None, full: bool, into: Path | None, comm: Any = None) -> bool:
    """The table, and whether all that must hold does. `into`: the outcomes as JSON. Collective."""
    ranks = Ranks(comm)
    screen, outcomes = Screen(ranks.is_root, False), []
    todo = list(settings(chosen(only, full)))
    advance = screen.count("cases", len(todo))
    for one, mode, dimension in todo:
        advance(f"{one.name} {where(mode, dimension)}")
        outcomes.append(examine(one, mode, dimension, comm))
    screen.stop()
    screen.say(table(outcomes, ranks.size))
    failed = [outcome for outcome in outcomes if not outcome.passed]
    bits = f", each with the bits of one rank on {ranks.size}" if ranks.size > 1 else ""
    screen.say(f"{len(outcomes) - len(failed)} of {len(outcomes)} hold{bits}")
    if into and ranks.is_root:
        into.write_text(json.dumps([plain(outcome) for outcome in outcomes], indent=1) + "\n")
    return not failed


def where(mode: str | None, dimension: int) -> str:
    """`event 3D`"""
    return f"{mode or ''} {dimension}D".strip()


def plain(outcome: Outcome) -> dict[str, Any]:
    """An outcome as numbers and texts."""
    one = outcome.case
    told = {"case": one.name, "naive": one.naive, "must": one.must, "mode": outcome.mode, "dimension": outcome.dimension}
    return told | {"measured": outcome.measured, "holds": outcome.holds, "same_bits": outcome.same_bits}


def table(outcomes: list[Outcome], ranks: int) -> Table:
    """A row for each mode and dimension; case, what naive programs do, and what must hold are told once."""
    shown = Table("case", "naive programs", "must hold", "where", "measured", "", box=None, padding=(0, 2, 0, 0), pad_edge=False)
    before = None
    for outcome in outcomes:
        one = outcome.case
        told = (one.name, one.naive, one.must) if one is not before else ("", "", "")
        verdict = "pass" if outcome.passed else ("FAIL" if not outcome.holds else f"FAIL: other bits on {ranks} ranks")
        shown.add_row(*told, where(outcome.mode, outcome.dimension), outcome.measured, verdict)
        before = one
    return shown
