"""One page with all that was measured: it opens offline, and needs no other file."""

from __future__ import annotations

import platform
from datetime import datetime
from html import escape
from pathlib import Path
from typing import Any

from particles_mpi.parallel.communicator import Communicator, mpi_library
from particles_mpi.run.doctor import usable_cores
from particles_mpi.study.measuring.experiment import Experiment
from particles_mpi.study.reporting import plots, tables

CSS = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #1a202c }
h1 { font-size: 1.7rem } h2 { margin-top: 2.6rem; border-bottom: 1px solid #ddd }
table { border-collapse: collapse; font-size: 12.5px; margin: .8rem 0; display: block; overflow-x: auto }
th, td { padding: .15rem .6rem; text-align: right; border-bottom: 1px solid #eee; white-space: nowrap }
th:first-child, td:first-child { text-align: left } tr.front { background: #fbf3d9; font-weight: 600 }
p.small, li.small { color: #555; font-size: 13px } svg { max-width: 100%; height: auto }
"""


def machine(ranks: Communicator) -> dict[str, Any]:
    """What it was measured on."""
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        name = next(
            (line.split(":")[1].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name")), name
        )
    when = datetime.now().astimezone().isoformat(timespec="minutes")
    return {
        "machine": name,
        "cores": usable_cores(),
        "ranks": ranks.size,
        "mpi": mpi_library(),
        "python": platform.python_version(),
        "when": when,
    }


def write(folder: Path, title: str, all_found: list[Experiment], about: dict[str, Any], notes: list[str]) -> Path:
    """report.html, a CSV and an SVG for each experiment, study.json; on one rank."""
    folder.mkdir(parents=True, exist_ok=True)
    for found in all_found:
        found.figure = plots.svg(found)
        (folder / f"{found.key}.svg").write_text(found.figure)
        tables.write_csv(folder / f"{found.key}.csv", found)
    tables.write_json(folder / "study.json", all_found, about)
    plots.central(folder / "accuracy.png", all_found)
    path = folder / "report.html"
    path.write_text(page(title, all_found, about, notes), encoding="utf-8")
    return path


def page(title: str, all_found: list[Experiment], about: dict[str, Any], notes: list[str]) -> str:
    """The whole page."""
    told = f"{about['machine']}, {about['cores']} cores, {about['ranks']} rank(s), {about['mpi']}, {about['when']}"
    samples = f"{about['samples']} samples of at least {about['least_seconds']:g} s"
    method = (
        f"Times: one warm-up, then the median of {samples} (± half the distance of the quartiles), settings by turns, the "
        "slowest rank, without output and compilation. Errors are the same to the bit each time and on any number of ranks. "
        "Rows on the Pareto front (nothing is both faster and more accurate) are marked."
    )
    parts = [f"<h1>{escape(title)}</h1>", f'<p class="small">{escape(told)}</p>', f"<p>{escape(method)}</p>"]
    parts += ["<ul>", *(f'<li><a href="#{f.key}">{f.key}: {escape(f.title)}</a></li>' for f in all_found), "</ul>"]
    parts.append(cost_of_accuracy(all_found))
    parts += [section(found) for found in all_found]
    parts += [f"<p>{escape(note)}</p>" for note in notes]
    body = "\n".join(parts)
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>'
    return f'<!doctype html>\n<html lang="en"><head>{head}<style>{CSS}</style></head>\n<body>\n{body}\n</body></html>\n'


def section(found: Experiment) -> str:
    """An experiment: picture, answers, table."""
    front = found.front()
    rows = "".join(
        f"<tr{' class=front' if row in front else ''}>" + "".join(f"<td>{escape(text)}</td>" for text in texts) + "</tr>\n"
        for row, texts in tables.cells(found)
    )
    heads = "".join(f"<th>{escape(text)}</th>" for text in tables.header(found))
    errors = "".join(f'<li class="small">{escape(name)}: {escape(text)}</li>' for name, text in found.errors.items())
    answers = "".join(f"<li>{escape(text)}</li>" for text in found.answers)
    return (
        f'<h2 id="{found.key}">{found.key}: {escape(found.title)}</h2>\n<p>Reference: {escape(found.reference)}.</p>\n'
        f"{found.figure}\n<ul>{answers}</ul>\n<ul>{errors}</ul>\n<table><tr>{heads}</tr>\n{rows}</table>"
    )


def cost_of_accuracy(all_found: list[Experiment]) -> str:
    """The table: what ten times more accuracy costs."""
    rows = "".join(
        f"<tr><td>{escape(title)}</td><td>{escape(curve)}</td><td>{escape(error)}</td><td>x {factor:.2g}</td></tr>\n"
        for title, curve, error, factor in tables.tenfolds(all_found)
    )
    if not rows:
        return ""
    heads = "".join(f"<th>{text}</th>" for text in ("problem", "setting", "a tenth of the error in", "time"))
    return f"<h2>What ten times more accuracy costs</h2>\n<table><tr>{heads}</tr>\n{rows}</table>"
