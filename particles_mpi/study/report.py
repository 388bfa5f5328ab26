"""What experiments found: as tables on the screen, as CSV, SVG and JSON files, and as one page that opens offline."""

from __future__ import annotations

import csv
import io
import json
import platform
from collections.abc import Iterator
from datetime import datetime
from html import escape
from math import isnan, log10, nan
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from particles_mpi.parallel.communicator import Communicator, mpi_library
from particles_mpi.run.console import WIDE
from particles_mpi.run.doctor import usable_cores
from particles_mpi.study import plots
from particles_mpi.study.experiment import Experiment, Row

DECADES, HOPELESS = 0.5, 100.0  # errors must fall by so many to tell what a tenth costs; a factor that is no convergence
WORK = ("forces", "interactions", "pair_tests", "events")
TENFOLD = "what ten times more accuracy costs"
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #1a202c }
h1 { font-size: 1.7rem } h2 { margin-top: 2.6rem; border-bottom: 1px solid #ddd }
pre { font-size: 12px; line-height: 1.35; overflow-x: auto }
p.small, li.small { color: #555; font-size: 13px } svg { max-width: 100%; height: auto }
"""


def number(value: float, digits: int = 2) -> str:
    """A short text; whole numbers with all their digits, nothing for what is not a number."""
    if abs(value) < 1e9 and value == round(value):
        return f"{round(value):,}".replace(",", " ")
    return "" if isnan(value) else f"{value:.{digits}g}" if 1e-3 <= abs(value) < 1e4 or not value else f"{value:.{digits - 1}e}"


def work_done(found: Experiment) -> list[str]:
    """The kinds of work that any setting did."""
    return [kind for kind in WORK if any(row.work.get(kind) for row in found.rows)]


def header(found: Experiment) -> list[str]:
    """Titles of the columns; errors are followed by their orders where the experiment has any."""
    errors = [title for name in found.errors for title in (name, "order")[: 1 + bool(found.slopes)]]
    return ["setting", found.parameter, *errors, "seconds", *work_done(found)]


def cells(found: Experiment) -> Iterator[tuple[Row, list[str]]]:
    """Each row with its texts; seconds with half the distance of their quartiles."""
    for row in found.rows:
        errors = [(number(row.errors[name]), number(row.orders[name]))[: 1 + bool(found.slopes)] for name in found.errors]
        s = row.seconds
        time = f"{number(s.median, 3)} ±{50.0 * (s.high - s.low) / s.median:2.0f}%"
        work = [f"{row.work.get(kind, 0):,}".replace(",", " ") for kind in work_done(found)]
        yield row, [row.setting.curve, number(row.setting.parameter, 3), *(x for pair in errors for x in pair), time, *work]


def table(found: Experiment) -> Table:
    """The rows of an experiment; those on the Pareto front are bold."""
    table, front = Table(*header(found), box=None, padding=(0, 2, 0, 0)), found.front()
    for column in table.columns:
        column.no_wrap = True
        column.justify = "right" if column is not table.columns[0] else "left"
    for row, texts in cells(found):
        table.add_row(*texts, style="bold" if row in front else None)
    return table


def tenfold(found: Experiment, curve: str) -> float:
    """Factor in seconds for a tenth of the main error, along the part of a curve that converges; not a number without one."""
    error = found.main_error
    falling: list[Row] = []
    for row in sorted(found.curve(curve), key=lambda r: r.seconds.median):
        if found.floor * 3.0 < row.errors[error] < 0.3 and (not falling or row.errors[error] < falling[-1].errors[error]):
            falling.append(row)
    if len(falling) < 2:
        return nan
    first, last = falling[0], falling[-1]
    decades = log10(first.errors[error] / last.errors[error])
    factor = (last.seconds.median / first.seconds.median) ** (1.0 / max(decades, 1e-9))
    return float(factor) if decades > DECADES and factor < HOPELESS else nan


def tenfold_table(all_found: list[Experiment]) -> Table:
    """What ten times more accuracy costs, for each curve that converges."""
    table = Table("problem", "setting", "a tenth of the error in", "time", title=TENFOLD, box=None)
    for found in all_found:
        for curve in found.curves:
            if not isnan(factor := tenfold(found, curve)):
                table.add_row(found.title, curve, found.main_error, f"x {factor:.2g}")
    return table


def write_csv(path: Path, found: Experiment) -> None:
    """The rows of an experiment, with all digits."""
    names, kinds, front = list(found.errors), work_done(found), found.front()
    titles = ["setting", found.parameter, *names, *(f"order of {name}" for name in names)]
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow([*titles, "seconds", "first quartile", "third quartile", *kinds, "on the front"])
        for row in found.rows:
            s = row.seconds
            errors = [*(row.errors[name] for name in names), *(row.orders[name] for name in names)]
            numbers = [row.setting.parameter, *errors, s.median, s.low, s.high]
            out.writerow([row.setting.curve, *map(repr, numbers), *(row.work.get(k, 0) for k in kinds), int(row in front)])


def plain(found: Experiment) -> dict[str, Any]:
    """An experiment for JSON: the errors are the same to the bit each time."""
    rows = [
        {
            "setting": row.setting.curve,
            "knob": row.setting.parameter,
            "errors": row.errors,
            "seconds": [row.seconds.low, row.seconds.median, row.seconds.high],
            "work": row.work,
        }
        for row in found.rows
    ]
    return {"key": found.key, "title": found.title, "reference": found.reference, "rows": rows, "answers": found.answers}


def machine(ranks: Communicator) -> dict[str, Any]:
    """What was measured on, and when."""
    name, cpuinfo = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if cpuinfo.exists():
        models = (line.split(":")[1].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name"))
        name = next(models, name)
    when = datetime.now().astimezone().isoformat(timespec="minutes")
    versions = {"mpi": mpi_library(), "python": platform.python_version()}
    return {"machine": name, "cores": usable_cores(), "ranks": ranks.size, **versions, "when": when}


def write(folder: Path, title: str, all_found: list[Experiment], about: dict[str, Any], notes: list[str]) -> Path:
    """Write report.html, a CSV and an SVG for each experiment, study.json and accuracy.png; on one rank."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {found.key: plots.svg(found) for found in all_found}
    for found in all_found:
        (folder / f"{found.key}.svg").write_text(figures[found.key])
        write_csv(folder / f"{found.key}.csv", found)
    experiments = [plain(found) for found in all_found]
    (folder / "study.json").write_text(json.dumps({**about, "experiments": experiments}, indent=1) + "\n")
    plots.central(folder / "accuracy.png", all_found)
    path = folder / "report.html"
    path.write_text(page(title, all_found, figures, about, notes), encoding="utf-8")
    return path


def page(title: str, all_found: list[Experiment], figures: dict[str, str], about: dict[str, Any], notes: list[str]) -> str:
    """The whole page; `figures`: SVG by key of the experiment."""
    place = f"{about['machine']}, {about['cores']} cores, {about['ranks']} rank(s), {about['mpi']}, {about['when']}"
    samples = f"{about['samples']} samples of at least {about['least_seconds']:g} s"
    method = (
        f"Times: one warm-up, then the median of {samples} (± half the distance of the quartiles), settings by turns, the "
        "slowest rank, without output and compilation. Errors are the same to the bit each time and on any number of ranks. "
        "Rows on the Pareto front (nothing is both faster and more accurate) are marked."
    )
    parts = [f"<h1>{escape(title)}</h1>", f'<p class="small">{escape(place)}</p>', f"<p>{escape(method)}</p>"]
    parts += ["<ul>", *(f'<li><a href="#{f.key}">{f.key}: {escape(f.title)}</a></li>' for f in all_found), "</ul>"]
    costs = tenfold_table(all_found)
    costs.title = None  # the page has a heading
    if costs.row_count:
        parts.append(f"<h2>{TENFOLD.capitalize()}</h2>\n{html(costs)}")
    for found in all_found:
        errors = [f'<li class="small">{escape(name)}: {escape(text)}</li>' for name, text in found.errors.items()]
        answers = [f"<li>{escape(text)}</li>" for text in found.answers]
        parts += [f'<h2 id="{found.key}">{found.key}: {escape(found.title)}</h2>']
        parts += [f"<p>Reference: {escape(found.reference)}.</p>", figures[found.key]]
        parts += ["<ul>", *answers, "</ul><ul>", *errors, "</ul>", html(table(found))]
    body = "\n".join([*parts, *(f"<p>{escape(note)}</p>" for note in notes)])
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>'
    return f'<!doctype html>\n<html lang="en"><head>{head}<style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n'


def html(table: Table) -> str:
    """A table of the screen as a part of a page."""
    console = Console(record=True, file=io.StringIO(), width=WIDE)
    console.print(table, crop=False)
    return console.export_html(inline_styles=True, code_format="<pre>{code}</pre>")
