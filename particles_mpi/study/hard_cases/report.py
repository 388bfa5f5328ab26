"""Runs the catalogue and prints its table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from particles_mpi.errors import SceneError
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.run.console import Screen
from particles_mpi.study.hard_cases import Case, Outcome, catalogue, examine, settings


def chosen(only: str | None, full: bool) -> list[Case]:
    """The cases whose names hold `only`, or one of several texts with | between; long ones if asked for, by `full` or by name."""
    parts = (only or "").lower().split("|")
    cases = [one for one in catalogue() if any(part in one.name.lower() for part in parts)]
    if not cases:
        raise SceneError(f"--only: no case has {only!r} in its name; there are: " + "; ".join(c.name for c in catalogue()))
    return [one for one in cases if full or only is not None or not one.long]


def study(only: str | None, full: bool, into: Path | None, comm: Any = None) -> bool:
    """The table, row by row as cases end, and whether all that must hold does. `into`: the outcomes as JSON. Collective."""
    ranks = Communicator(comm)
    screen, outcomes, before = Screen(ranks.is_root, False), [], None
    todo = list(settings(chosen(only, full)))
    advance = screen.count("cases", len(todo))
    for one, mode, dimension in todo:
        if one is not before:
            screen.say(f"[bold]{one.name}[/bold]\n  naive programs: {one.naive}\n  must hold: {one.must}")
            before = one
        advance(f"{one.name} {where(mode, dimension)}")
        outcomes.append(examine(one, mode, dimension, comm))
        screen.say(line(outcomes[-1], ranks.size))
    screen.stop()
    failed = [outcome for outcome in outcomes if not outcome.passed]
    bits = f", each with the bits of one rank on {ranks.size}" if ranks.size > 1 else ""
    screen.say(f"{len(outcomes) - len(failed)} of {len(outcomes)} hold{bits}")
    if into and ranks.is_root:
        into.write_text(json.dumps([plain(outcome) for outcome in outcomes], indent=1) + "\n")
    return not failed


def line(outcome: Outcome, ranks: int) -> str:
    """A row of the table: where, pass or fail, what was measured."""
    verdict = (
        "pass"
        if outcome.passed
        else ("[red]FAIL[/red]" if not outcome.holds else f"[red]FAIL[/red], other bits on {ranks} ranks")
    )
    return f"  {where(outcome.mode, outcome.dimension):<10} {verdict}   {outcome.measured}"


def where(mode: str | None, dimension: int) -> str:
    """`event 3D`"""
    return f"{mode or ''} {dimension}D".strip()


def plain(outcome: Outcome) -> dict[str, Any]:
    """An outcome as numbers and texts."""
    one = outcome.case
    told = {"case": one.name, "naive": one.naive, "must": one.must, "mode": outcome.mode, "dimension": outcome.dimension}
    return told | {"measured": outcome.measured, "holds": outcome.holds, "same_bits": outcome.same_bits}
