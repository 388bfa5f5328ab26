"""`study hard-cases`: runs the catalogue and prints its table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from particles_mpi.errors import SceneError
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.run.console import Screen
from particles_mpi.study.hard_cases.catalogue import Case, catalogue, examine, settings


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
    screen, before = Screen(ranks.is_root, False), None
    found: list[dict[str, Any]] = []
    waiting = list(settings(chosen(only, full)))
    advance = screen.count("cases", len(waiting))
    for one, mode, dimension in waiting:
        if one is not before:
            screen.say(f"[bold]{one.name}[/bold]\n  naive programs: {one.naive}\n  must hold: {one.must}")
            before = one
        advance(f"{one.name} {where(mode, dimension)}")
        *_, measured, holds, same_bits = examine(one, mode, dimension, comm)
        wrong = "" if same_bits or not holds else f", other bits on {ranks.size} ranks"
        verdict = "pass" if holds and same_bits else f"[red]FAIL[/red]{wrong}"
        screen.say(f"  {where(mode, dimension):<10} {verdict}   {measured}")
        about = {"case": one.name, "naive": one.naive, "must": one.must, "mode": mode, "dimension": dimension}
        found.append(about | {"measured": measured, "holds": holds, "same_bits": same_bits})
    screen.stop()
    held = sum(one["holds"] and one["same_bits"] for one in found)
    bits = f", each with the bits of one rank on {ranks.size}" if ranks.size > 1 else ""
    screen.say(f"{held} of {len(found)} hold{bits}")
    if into and ranks.is_root:
        into.write_text(json.dumps(found, indent=1) + "\n")
    return held == len(found)


def where(mode: str | None, dimension: int) -> str:
    """`event 3D`"""
    return f"{mode or ''} {dimension}D".strip()
