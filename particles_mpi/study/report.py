"""Reports the results of experiments: as tables on the screen, as CSV, SVG and JSON files, and as one offline page."""

import csv
import io
import json
import platform
from datetime import datetime
from html import escape
from math import isnan, log10, nan
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from particles_mpi.output.replacing import replacing
from particles_mpi.parallel.communicator import Communicator, mpi_library
from particles_mpi.run.console import LOG_WIDTH
from particles_mpi.run.doctor import usable_cores
from particles_mpi.study.experiment import Experiment, Row

LEAST_DECADES = 0.5  # by so many errors must fall along a curve to tell what a tenth of the error costs
LARGEST_FACTOR = 100.0  # for a tenth of the error: with a larger one a curve does not converge
WORK_TITLES = {"forces": "forces", "interactions": "pairs", "pair_tests": "tests", "events": "contacts"}  # by kind of work
TENFOLD = "what ten times more accuracy costs"
METHOD = """Times: one warm-up, then the median of {samples} samples of at least {least_seconds:g} s (± half the distance of the
quartiles), measured for the settings in turn, on the slowest rank, without output and compilation. Errors are the same to the bit
each time and on any number of ranks. Rows on the Pareto front (nothing is both faster and more accurate) are marked."""
PAGE_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #1a202c }
h1 { font-size: 1.7rem } h2 { margin-top: 2.6rem; border-bottom: 1px solid #ddd }
pre { font-size: 12px; line-height: 1.35; overflow-x: auto }
p.small, li.small { color: #555; font-size: 13px } svg { max-width: 100%; height: auto }
"""


def grouped(value: float) -> str:
    """Return a number as text, rounded to a whole one, with spaces between thousands."""
    return f"{value:,.0f}".replace(",", " ")


def number(value: float, digits: int = 2) -> str:
    """Return a number as short text; whole numbers with all their digits, "" for nan."""
    if abs(value) < 1e9 and value == round(value):
        return grouped(round(value))
    return "" if isnan(value) else f"{value:.{digits}g}" if 1e-3 <= abs(value) < 1e4 else f"{value:.{digits - 1}e}"


def numbers_table(first: str, *titles: str) -> Table:
    """Return a table for the screen, without lines; the first column holds names, the others numbers."""
    columns = [Column(title, justify="right", no_wrap=True) for title in titles]
    return Table(Column(first, no_wrap=True), *columns, box=None, padding=(0, 2, 0, 0))


def work_done(found: Experiment) -> list[str]:
    """Return the kinds of work that any setting did."""
    return [kind for kind in WORK_TITLES if any(row.work.get(kind) for row in found.rows)]


def errors_table(found: Experiment) -> Table:
    """Return the table of an experiment; rows on the Pareto front are bold.

    Errors are followed by their orders where the experiment has any, seconds by half the distance of their quartiles.
    """
    pairs = 1 + bool(found.slopes)
    errors = [title for name in found.errors for title in (name, "order")[:pairs]]
    texts, front = numbers_table("setting", found.parameter, *errors, "seconds", *work_done(found)), found.front()
    for row in found.rows:
        errors = [text for name in found.errors for text in (number(row.errors[name]), number(row.orders[name]))[:pairs]]
        s = row.seconds
        time = f"{number(s.median, 3)} ±{50.0 * (s.high - s.low) / s.median:2.0f}%"
        work = [grouped(row.work.get(kind, 0)) for kind in work_done(found)]
        style = "bold" if row in front else None
        texts.add_row(row.setting.curve, number(row.setting.parameter, 3), *errors, time, *work, style=style)
    return texts


def tenfold(found: Experiment, curve: str) -> float:
    """Return the factor in seconds for a tenth of the main error, along the converging part of a curve; nan without one."""
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
    return float(factor) if decades > LEAST_DECADES and factor < LARGEST_FACTOR else nan


def tenfold_table(all_found: list[Experiment]) -> Table:
    """Return a table of what ten times more accuracy costs, for each curve that converges."""
    table = Table("problem", "setting", "a tenth of the error in", "time", title=TENFOLD, box=None)
    for found in all_found:
        for curve in found.curves:
            if not isnan(factor := tenfold(found, curve)):
                table.add_row(found.title, curve, found.main_error, f"x {factor:.2g}")
    return table


def write_csv(path: Path, rows: list[dict[str, Any]]) -> Path:
    """Write rows with the same keys, with all digits."""
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, list(rows[0]) if rows else [])
        out.writeheader()
        out.writerows(rows)
    return path


def csv_rows(found: Experiment) -> list[dict[str, Any]]:
    """Return the rows of the CSV file of an experiment, one for each setting."""
    front, kinds = found.front(), work_done(found)
    return [
        {"setting": row.setting.curve, found.parameter: row.setting.parameter}
        | {name: row.errors[name] for name in found.errors}
        | {f"order of {name}": row.orders[name] for name in found.errors}
        | {"seconds": row.seconds.median, "first quartile": row.seconds.low, "third quartile": row.seconds.high}
        | {kind: row.work.get(kind, 0) for kind in kinds}
        | {"on the front": int(row in front)}
        for row in found.rows
    ]


def as_json(found: Experiment) -> dict[str, Any]:
    """Return an experiment as JSON data; the errors are the same to the bit each time."""
    rows = [
        {"setting": row.setting.curve, "parameter": row.setting.parameter, "errors": row.errors}
        | {"seconds": [row.seconds.low, row.seconds.median, row.seconds.high], "work": row.work}
        for row in found.rows
    ]
    return {"key": found.key, "title": found.title, "reference": found.reference, "rows": rows, "answers": found.answers}


def describe_machine(ranks: Communicator) -> dict[str, Any]:
    """Return on which machine was measured, and when."""
    name, cpuinfo = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if cpuinfo.exists():
        models = (line.split(":")[1].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name"))
        name = next(models, name)
    when = datetime.now().astimezone().isoformat(timespec="minutes")
    versions = {"mpi": mpi_library(), "python": platform.python_version()}
    return {"machine": name, "cores": usable_cores(), "ranks": ranks.size, **versions, "when": when}


def write_report(folder: Path, title: str, all_found: list[Experiment], about: dict[str, Any]) -> Path:
    """Write report.html, a CSV and an SVG for each experiment, study.json and accuracy.png into a folder; on one rank."""
    from particles_mpi.study import plots

    folder.mkdir(parents=True, exist_ok=True)
    figures = {found.key: plots.svg(found) for found in all_found}
    for found in all_found:
        (folder / f"{found.key}.svg").write_text(figures[found.key])
        write_csv(folder / f"{found.key}.csv", csv_rows(found))
    experiments = [as_json(found) for found in all_found]
    (folder / "study.json").write_text(json.dumps({**about, "experiments": experiments}, indent=1) + "\n")
    plots.draw_for_readme(folder / "accuracy.png", all_found)
    path = folder / "report.html"
    path.write_text(page(title, all_found, figures, about), encoding="utf-8")
    return path


def page(title: str, all_found: list[Experiment], figures: dict[str, str], about: dict[str, Any]) -> str:
    """Return the whole page; `figures`: SVG by key of the experiment."""
    place = "{machine}, {cores} cores, {ranks} rank(s), {mpi}, {when}".format(**about)
    links = "".join(f'<li><a href="#{found.key}">{found.key}: {escape(found.title)}</a></li>\n' for found in all_found)
    parts = [f'<h1>{escape(title)}</h1>\n<p class="small">{escape(place)}</p>\n<p>{escape(METHOD.format(**about))}</p>']
    parts.append(f"<ul>\n{links}</ul>")
    costs = tenfold_table(all_found)
    costs.title = None  # the page has a heading
    if costs.row_count:
        parts.append(f"<h2>{TENFOLD.capitalize()}</h2>\n{table_html(costs)}")
    for found in all_found:
        answers = "".join(f"<li>{escape(text)}</li>\n" for text in found.answers)
        errors = "".join(f'<li class="small">{escape(name)}: {escape(text)}</li>\n' for name, text in found.errors.items())
        parts += [
            f'<h2 id="{found.key}">{found.key}: {escape(found.title)}</h2>',
            f"<p>Reference: {escape(found.reference)}.</p>",
            figures[found.key],
            f"<ul>\n{answers}</ul><ul>\n{errors}</ul>",
            table_html(errors_table(found)),
        ]
    body = "\n".join(parts)
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>'
    return f'<!doctype html>\n<html lang="en"><head>{head}<style>{PAGE_STYLE}</style></head>\n<body>\n{body}\n</body></html>\n'


def table_html(table: Table) -> str:
    """Return a table of the screen as a part of a page."""
    console = Console(record=True, file=io.StringIO(), width=LOG_WIDTH)
    console.print(table, crop=False)
    return console.export_html(inline_styles=True, code_format="<pre>{code}</pre>")
