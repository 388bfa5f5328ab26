"""An experiment as text: the table of a screen, a page and a CSV file, and what ten times more accuracy costs."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from math import isnan, log10
from pathlib import Path
from typing import Any

from particles_mpi.study.measuring.experiment import Experiment, Row

DECADES, HOPELESS = 0.5, 100.0  # errors must fall by so many to tell what a tenth costs; a factor that is no convergence


def number(value: float, digits: int = 2) -> str:
    """Short; whole ones as they are."""
    if abs(value) < 1e9 and value == round(value):
        return f"{round(value):,}".replace(",", " ")
    return "" if isnan(value) else f"{value:.{digits}g}" if 1e-3 <= abs(value) < 1e4 or not value else f"{value:.{digits - 1}e}"


def header(found: Experiment) -> list[str]:
    """Column titles."""
    errors = [title for name in found.errors for title in (name, "order")[: 1 + ordered(found)]]
    return ["setting", found.knob, *errors, "seconds", *works(found)]


def ordered(found: Experiment) -> bool:
    """Has it orders of convergence?"""
    return bool(found.slopes)


def works(found: Experiment) -> list[str]:
    """The kinds of work that any setting did."""
    return [kind for kind in ("forces", "interactions", "pair_tests", "events") if any(row.work.get(kind) for row in found.rows)]


def cells(found: Experiment) -> Iterator[tuple[Row, list[str]]]:
    """Each row as texts; seconds with half the distance of their quartiles."""
    for row in found.rows:
        errors = [
            text for name in found.errors for text in (number(row.errors[name]), number(row.orders[name]))[: 1 + ordered(found)]
        ]
        s = row.seconds
        time = f"{number(s.median, 3)} ±{50.0 * (s.high - s.low) / s.median:2.0f}%"
        work = [f"{row.work.get(kind, 0):,}".replace(",", " ") for kind in works(found)]
        yield row, [row.setting.curve, number(row.setting.knob, 3), *errors, time, *work]


def write_csv(path: Path, found: Experiment) -> None:
    """All digits."""
    names = list(found.errors)
    kinds = works(found)
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        orders = [f"order of {n}" for n in names]
        out.writerow(
            ["setting", found.knob, *names, *orders, "seconds", "first quartile", "third quartile", *kinds, "on the front"]
        )
        front = found.front()
        for row in found.rows:
            s = row.seconds
            numbers = [
                row.setting.knob,
                *(row.errors[n] for n in names),
                *(row.orders[n] for n in names),
                s.median,
                s.low,
                s.high,
            ]
            out.writerow([row.setting.curve, *map(repr, numbers), *(row.work.get(k, 0) for k in kinds), int(row in front)])


def plain(found: Experiment) -> dict[str, Any]:
    """For JSON: errors are the same to the bit each time."""
    rows = [
        {
            "setting": row.setting.curve,
            "knob": row.setting.knob,
            "errors": row.errors,
            "seconds": [row.seconds.low, row.seconds.median, row.seconds.high],
            "work": row.work,
        }
        for row in found.rows
    ]
    return {"key": found.key, "title": found.title, "reference": found.reference, "rows": rows, "answers": found.answers}


def write_json(path: Path, all_found: list[Experiment], about: dict[str, Any]) -> None:
    """Everything that was measured."""
    path.write_text(json.dumps({**about, "experiments": [plain(found) for found in all_found]}, indent=1) + "\n")


def tenfold(found: Experiment, curve: str) -> float:
    """Factor in seconds for a tenth of the first error, along the part of a curve that converges; not a number without one."""
    error = next(iter(found.errors))
    falling: list[Row] = []
    for row in sorted(found.curve(curve), key=lambda r: r.seconds.median):
        if found.floor * 3.0 < row.errors[error] < 0.3 and (not falling or row.errors[error] < falling[-1].errors[error]):
            falling.append(row)
    if len(falling) < 2:
        return float("nan")
    first, last = falling[0], falling[-1]
    decades = log10(first.errors[error] / last.errors[error])
    factor = (last.seconds.median / first.seconds.median) ** (1.0 / max(decades, 1e-9))
    return float(factor) if decades > DECADES and factor < HOPELESS else float("nan")


def tenfolds(all_found: list[Experiment]) -> list[tuple[str, str, str, float]]:
    """(experiment, setting, error, factor) wherever there is one."""
    return [
        (found.title, curve, next(iter(found.errors)), factor)
        for found in all_found
        for curve in found.curves
        if not isnan(factor := tenfold(found, curve))
    ]
