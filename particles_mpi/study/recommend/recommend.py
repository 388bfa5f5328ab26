"""Finds the cheapest setting of a scene that reaches a tolerance: searches, times fairly, verifies at half the step, writes."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from errno import EISDIR
from math import isfinite
from pathlib import Path

from rich.table import Table

from particles_mpi import Scene
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.output.replacing import replace_text, temporary_of
from particles_mpi.run.console import Screen
from particles_mpi.run.scene_file import load
from particles_mpi.scene.model import suggestion
from particles_mpi.study.experiment import Benchmark, Errors
from particles_mpi.study.recommend.error_metric import ERROR_NAMES
from particles_mpi.study.recommend.methods import as_it_is, frames, methods
from particles_mpi.study.recommend.reference import reference
from particles_mpi.study.recommend.runs import Start
from particles_mpi.study.recommend.search import BUDGET_SECONDS, Search, Trial, time_trials
from particles_mpi.study.recommend.tuned import Tables, tuned, written
from particles_mpi.study.report import WORK_TITLES, numbers_table

UNUSABLE_ERROR = 0.05  # error of the scene as it is, from which nothing can be concluded
SHORT_RUN_SECONDS = 0.05  # seconds of a run that is begun anew so often that short samples must do


@dataclass
class Recommendation:
    """`best`: the cheapest setting measured that reaches the `tolerance` of the whole run; `timed`: all that were compared.

    `tables`: of the tuned scene. `half`: errors of the best at half the step (`adaptive`: a tenth of the tolerance), and the
    `difference` between the two runs. `dropped`: settings that half the step did not confirm. `search`: all that were tried,
    for which error, by which metric, on which ranks.
    """

    tolerance: float
    best: Trial
    tables: Tables
    half: Errors
    difference: float
    timed: list[Trial]
    dropped: list[str]
    search: Search


def recommend(
    benchmark: Benchmark, scene: Scene, tolerance: float, error: str = "", seconds: float = BUDGET_SECONDS
) -> Recommendation | None:
    """Find the recommendation. Collective; few bodies are computed on rank 0 alone, and other ranks get None.

    SceneError if the tolerance cannot be measured, StoppedError if nothing in these seconds reaches it.
    """
    if not 0.0 < tolerance < 1.0:
        raise SceneError(f"--tolerance {tolerance:g}: must be above 0 and below 1")
    if error and error not in ERROR_NAMES:
        raise SceneError(f"--error {error}: there is no such error{suggestion(error, list(ERROR_NAMES))}")
    try:
        return Start(benchmark, scene).on_few(lambda start: find(start, tolerance, error, seconds))
    finally:
        benchmark.screen.stop()


def find(start: Start, tolerance: float, error: str, seconds: float) -> Recommendation:
    """Do what `recommend` describes, on the ranks of the start's benchmark."""
    benchmark, ways, (as_given, resolution) = start.benchmark, methods(start), as_it_is(start)
    for method in (as_given, *ways):
        method.least = frames(start.scene)
    progress = benchmark.screen.count("recommend", 1 + len(ways))
    progress("reference")
    metric = reference(start, seconds, error)
    search = Search(start, metric, metric.choose(tolerance, error), seconds / 3.0)
    own = search.attempt(as_given, resolution)
    # what is likely the cheapest comes first, and cuts the others short; only `adaptive` is sure to get through
    order = {
        "order4": 1,
        "adaptive": 0 if own is None or search.size(own.errors) > UNUSABLE_ERROR else 2,
        "leapfrog": 3,
        "taylor": 4,
    }
    for method in sorted(ways, key=lambda method: order[method.integrator]):
        progress(f"search: {method.name}")
        search.along(method, search.first(method, own))
    benchmark.screen.stop()
    finalists = search.finalists()
    if not finalists:
        raise StoppedError(f"--tolerance {tolerance:g}: not reached in {seconds:.0f} s of measuring: " + nearest(search))
    enter_times(start, finalists, metric.part)
    left, dropped, best = sorted(finalists, key=lambda trial: trial.timed.median), list[str](), None
    while left and (best is None or left[0].timed.median < best[0].timed.median):
        trial = left.pop(0)
        confirmed = search.confirm(trial)
        if confirmed is None or confirmed[0] is not trial:
            dropped.append(trial.name)
        if confirmed and confirmed[0] is not trial:
            enter_times(start, [confirmed[0]], metric.part)
        if confirmed and (best is None or confirmed[0].timed.median < best[0].timed.median):
            best = confirmed
    if best is None:
        raise StoppedError(f"--tolerance {tolerance:g}: reached by chance only, half the step does not confirm it: " + dropped[0])
    trial, finer, difference = best
    tables = tuned(start.scene, trial.scene, trial.method.whole_steps(trial.resolution, metric.part))
    return Recommendation(tolerance, trial, tables, finer.errors, difference, [trial, *left], dropped, search)


def enter_times(start: Start, trials: list[Trial], part: float) -> None:
    """Measure the seconds of trials in turn, and enter those of the whole run. Collective."""
    short = all(trial.seconds < SHORT_RUN_SECONDS for trial in trials)
    rows = time_trials(start, trials, min(start.benchmark.sample_seconds, SHORT_RUN_SECONDS) if short else None)
    for trial, row in zip(trials, rows, strict=True):
        trial.timed = row.seconds.of(round(1.0 / part))


def nearest(search: Search) -> str:
    """Return a text: the best of what was tried."""
    tried = [trial for trial in search.trials if isfinite(search.size(trial.errors))]
    if not tried:
        return "; ".join(f"{name}: {why}" for name, why in search.refused.items())
    best = min(tried, key=lambda trial: search.size(trial.errors))
    return f"the best is {best.name}, {search.described(best.errors)}"


def report(screen: Screen, found: Recommendation) -> None:
    """Print the whole recommendation."""
    search, trial, s, say = found.search, found.best, found.best.timed, screen.say
    metric, names = search.metric, ", ".join(search.tolerances)
    scene, method = metric.start.scene, trial.method
    say(f": {metric.start.total} particles, wanted: {names} within {found.tolerance:g}", head=scene.title or "untitled scene")
    finest = ", ".join(f"{name} {metric.limits[name]:.1g}" for name in search.tolerances)
    say(f"  reference: {metric.reference}; the smallest errors that can be measured: {finest} ({metric.why})")
    if left_out := [f"{name} {limit:.1g}" for name, limit in metric.limits.items() if name not in search.tolerances]:
        say(f"  not compared with the tolerance (not asked for, or not measurable so finely): {', '.join(left_out)}")
    if metric.part < 1.0:
        say(
            f": a reference for the whole run takes too long; errors there must be within {search.described(search.tolerances)}",
            head=f"  errors are those of the first 1/{1 / metric.part:.0f} of the run (t = {metric.span:.4g})",
        )
    screen.table(trials_table(found))
    for name, why in found.search.refused.items():
        say(f"  {name}: {why}")
    for name in found.dropped:
        say(f"  {name}: not confirmed at half the step: reaches it only at the snapshots, or by chance")
    steps = method.whole_steps(trial.resolution, metric.part)
    finer, tolerance = "half the step", ""
    if method.adaptive:
        finer, tolerance = "a tenth of the tolerance", f", {method.describe(trial.resolution, metric.part)}"
    say(
        f": {search.described(trial.errors)}; the whole run takes {s.median:.3g} s ({s.low:.3g} to {s.high:.3g}) on "
        f"{metric.start.benchmark.ranks.size} rank(s), output not counted",
        head=f"recommended: {method.name}, {steps} steps of {metric.start.duration / steps:.6g}{tolerance}",
    )
    differ = f"{found.difference:.2g} at most" + (", in every step" if search.places else "")
    say(f"  verified at {finer}: {search.described(found.half)}; the two runs differ by {differ}")
    if metric.part < 1.0:
        say(
            f"  not verified after t = {metric.span:.4g}: errors may grow faster there; a larger --seconds covers more of the run"
        )


def trials_table(found: Recommendation) -> Table:
    """Return a table of all settings that were tried, with the times of those that were compared; the best is bold."""
    names, trials = found.search.metric.limits, sorted(found.search.trials, key=lambda t: (t.method.name, t.resolution))
    works = [name for name in WORK_TITLES if any(trial.work[name] for trial in trials)]
    table = numbers_table("setting", *names, "seconds", *(WORK_TITLES[name] for name in works))
    for trial in trials:
        s = trial.timed
        seconds = f"{s.median:.3g} ({s.low:.3g}-{s.high:.3g})" if s.median > 0.0 else ""
        errors, work = (f"{trial.errors[name]:.2g}" for name in names), (str(trial.work[name]) for name in works)
        table.add_row(trial.name, *errors, seconds, *work, style="bold" if trial is found.best else None)
    return table


def recommend_scene(
    path: Path, tolerance: float, error: str = "", output: Path | None = None, seconds: float = BUDGET_SECONDS
) -> Recommendation | None:
    """Do what `study recommend` does: find, print, and write the tuned scene (by default to NAME.tuned.toml). Collective."""
    benchmark, target = Benchmark(quiet=False), output or path.with_suffix(".tuned.toml")
    scene = load(path)
    if target.resolve() == path.resolve():
        raise SceneError(f"--output {target}: is the scene file itself; choose another file")
    benchmark.ranks.run_on_root(lambda: require_writable(target))
    found = recommend(benchmark, scene, tolerance, error, seconds)
    if found:
        report(benchmark.screen, found)
    benchmark.ranks.run_on_root(lambda: save(found, path, target) if found else None)
    benchmark.screen.say(f"written: {target}", whole=True)
    return found


@contextmanager
def cannot_be_written(target: Path) -> Iterator[None]:
    """Raise SceneError in place of an OSError."""
    try:
        yield
    except OSError as error:
        raise SceneError(f"--output {target}: cannot be written ({error.strerror})") from None


def require_writable(target: Path) -> None:
    """Raise SceneError if the file cannot be written: that should be known before all is measured. On one rank."""
    with cannot_be_written(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir():
            raise IsADirectoryError(EISDIR, os.strerror(EISDIR))
        temporary_of(target).touch()
        temporary_of(target).unlink()


def save(found: Recommendation, source: Path, target: Path) -> None:
    """Write the tuned scene; on one rank."""
    ranks, metric = found.search.start.benchmark.ranks.size, found.search.metric
    until = f" to t = {metric.span:.4g}, not measured after that" if metric.part < 1.0 else ""
    remark = (
        f"by study recommend: {found.search.described(found.best.errors)} (wanted: {found.tolerance:g}{until}), "
        f"about {found.best.timed.median:.2g} s on {ranks} rank(s)"
    )
    with cannot_be_written(target):
        replace_text(target, written(found.tables, source, target, remark))
