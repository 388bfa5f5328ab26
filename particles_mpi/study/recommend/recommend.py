"""The cheapest setting of a scene that reaches a tolerance: searched, timed fairly, verified at half the step, written down."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite, nan
from pathlib import Path
from typing import Any

from rich.table import Table

from particles_mpi import Scene
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.parallel.agreement import raising_together, same_on_all
from particles_mpi.run.console import Screen
from particles_mpi.study.experiment import Benchmark, Errors
from particles_mpi.study.recommend.error_metric import ErrorMetric
from particles_mpi.study.recommend.methods import Method, as_it_is, methods
from particles_mpi.study.recommend.reference import reference
from particles_mpi.study.recommend.runs import FEW, Start
from particles_mpi.study.recommend.search import Search, Trial, first, time_trials
from particles_mpi.study.recommend.tuned import Tables, tuned, written
from particles_mpi.study.timing import Seconds

BUDGET = 60.0  # seconds of measuring, about: a third each for the reference, the search, and times
WORK = {"forces": "forces", "interactions": "pairs", "pair_tests": "tests", "events": "contacts"}
LOST = 0.05  # error of the scene as it is, from which nothing can be concluded
SHORT = 0.05  # seconds of a run that is begun anew so often that short samples must do


@dataclass
class Timed:
    """A trial with the seconds of the whole run, output not counted."""

    trial: Trial
    seconds: Seconds


@dataclass
class Recommendation:
    """`best`: the cheapest setting measured that reaches the tolerance for `error`, in so many `steps` of the whole run.

    `tables`: of the tuned scene. `half`: errors of the best at half the step (`adaptive`: a tenth of the tolerance), and the
    `difference` between the two runs. `timed`: all that were compared, `trials`: all that were tried, `refused`: what was not,
    and why, `dropped`: settings that half the step did not confirm.
    """

    tolerance: float
    error: str
    best: Timed
    steps: int
    tables: Tables
    half: Errors
    difference: float
    timed: list[Timed]
    metric: ErrorMetric
    trials: list[Trial]
    refused: dict[str, str]
    ranks: int
    dropped: list[str] = field(default_factory=list)


def recommend(
    benchmark: Benchmark, scene: Scene, tolerance: float, error: str = "", seconds: float = BUDGET
) -> Recommendation | None:
    """Find it. Collective; a few bodies are computed on rank 0 alone, and other ranks get None.

    SceneError if the tolerance cannot be measured, StoppedError if nothing in these seconds reaches it.
    """
    if not 0.0 < tolerance < 1.0:
        raise SceneError(f"--tolerance {tolerance:g}: must be above 0 and below 1")
    start = Start(benchmark, scene)
    try:
        found: Recommendation | None = benchmark.on_few(
            start.total <= FEW, lambda b: find(start if b is benchmark else Start(b, scene), tolerance, error, seconds)
        )
        return found
    finally:
        benchmark.screen.stop()


def find(start: Start, tolerance: float, error: str, seconds: float) -> Recommendation:
    """The same, on the ranks of the start's benchmark."""
    benchmark = start.benchmark
    progress = benchmark.screen.count("recommend", 1 + len(methods(start)))
    progress("reference")
    metric = reference(start, seconds, error)
    error = metric.choose(tolerance, error)
    search = Search(start, metric, error, tolerance * metric.share(error), seconds / 3.0)
    own = search.attempt(*as_it_is(start))
    for method in in_order(start, lost=own is None or own.errors[error] > LOST):
        progress(f"search: {method.name}")
        search.along(method, first(method, search, own))
    benchmark.screen.stop()
    finalists = search.finalists()
    if not finalists:
        raise StoppedError(f"--tolerance {tolerance:g}: not reached in {seconds:.0f} s of measuring: " + nearest(search))
    timed = sorted(time_runs(start, finalists, metric), key=lambda one: one.seconds.median)
    dropped: list[str] = []
    for best in timed:
        half, difference = verify(search, best.trial)
        if half and search.reached(half) and difference <= 2.0 * search.tolerance:
            break
        dropped.append(best.trial.name)
    else:
        raise StoppedError(f"--tolerance {tolerance:g}: reached by chance only: half the step does not confirm " + dropped[0])
    steps = best.trial.method.steps(best.trial.resolution, 1.0)
    tables = tuned(start.scene, best.trial.scene, steps)
    return Recommendation(tolerance, error, best, steps, tables, half, difference, timed, metric, search.trials,
                          search.refused, benchmark.ranks.size, dropped)  # fmt: skip


def in_order(start: Start, lost: bool) -> list[Method]:
    """Methods, first those that are likely the cheapest: what is reached early cuts the others short. `lost`: as it is the
    scene is so wrong that only `adaptive` is sure to get through."""
    order = {"order4": 1, "adaptive": 0 if lost else 2, "leapfrog": 3, "taylor": 4}
    return sorted(methods(start), key=lambda method: order[method.integrator])


def nearest(search: Search) -> str:
    """The best of what was tried, in words."""
    tried = [trial for trial in search.trials if isfinite(trial.errors[search.error])]
    if not tried:
        return "; ".join(f"{name}: {why}" for name, why in search.refused.items())
    best = min(tried, key=lambda trial: trial.errors[search.error])
    return f"the best is {best.name}, {search.error} {best.errors[search.error]:.2g}"


def time_runs(start: Start, trials: list[Trial], metric: ErrorMetric) -> list[Timed]:
    """Seconds of the whole run for each, by turns. Collective."""
    short = all(trial.seconds < SHORT for trial in trials)
    rows = time_trials(start, trials, min(start.benchmark.least, SHORT) if short else None)
    return [Timed(trial, row.seconds.of(round(1.0 / metric.part))) for trial, row in zip(trials, rows, strict=True)]


def verify(search: Search, trial: Trial) -> tuple[Errors, float]:
    """(errors at half the step, difference between the two runs), the latter in the units of the error. Collective."""
    before = len(search.trials)
    finer = search.attempt(trial.method, trial.resolution * trial.method.ratio)
    del search.trials[before:]
    if finer is None:
        return {}, nan
    return finer.errors, search.metric.difference(search.error, trial.record, finer.record)


def report(screen: Screen, found: Recommendation) -> None:
    """All of it on the screen."""
    metric, error, best, say = found.metric, found.error, found.best, screen.say
    scene, method = metric.start.scene, found.best.trial.method
    say(f"[bold]{scene.title or 'untitled scene'}[/bold]: {metric.start.total} particles, {error} to {found.tolerance:g}")
    say(f"  reference: {metric.reference}; {error} can be measured down to {metric.limits[error]:.1g} ({metric.why})")
    if metric.part < 1.0:
        say(
            f"  [yellow]errors are those of the first 1/{1 / metric.part:.0f} of the run (t = {metric.span:.4g})[/yellow]: a "
            f"reference of all of it would take too long; {error} is held to {found.tolerance * metric.share(error):.2g} there"
        )
    say(trials_table(found))
    for name, why in found.refused.items():
        say(f"  {name}: {why}")
    for name in found.dropped:
        say(f"  {name}: reaches it by chance, not at half the step")
    finer = "a tenth of the tolerance" if method.adaptive else "half the step"
    step = f"{found.steps} steps of {scene.steps * scene.time.step / found.steps:.6g}"
    words = f"{method.name}, {step}{', ' + method.describe(best.trial.resolution) if method.adaptive else ''}"
    s = best.seconds
    say(
        f"[bold]recommended: {words}[/bold]: {error} {best.trial.errors[error]:.2g}; the whole run takes {s.median:.3g} s "
        f"({s.low:.3g} to {s.high:.3g}) on {found.ranks} rank(s), output not counted"
    )
    say(f"  verified at {finer}: {error} {found.half[error]:.2g}, the two runs differ by {found.difference:.2g}")


def trials_table(found: Recommendation) -> Table:
    """All settings that were tried, with the times of those that were compared; the best is bold."""
    names, works = found.metric.names, [name for name in WORK if any(trial.work[name] for trial in found.trials)]
    table = Table("setting", *names, "seconds", *(WORK[name] for name in works), box=None, padding=(0, 1, 0, 1))
    for column in table.columns:
        column.no_wrap = True
    times = {id(one.trial): one.seconds for one in found.timed}
    for trial in sorted(found.trials, key=lambda t: (t.method.name, t.resolution)):
        s = times.get(id(trial))
        seconds = f"{s.median:.3g} ({s.low:.3g}-{s.high:.3g})" if s else ""
        errors, work = (f"{trial.errors[name]:.2g}" for name in names), (str(trial.work[name]) for name in works)
        table.add_row(trial.name, *errors, seconds, *work, style="bold" if trial is found.best.trial else None)
    return table


def recommend_scene(
    path: Path, tolerance: float, error: str = "", output: Path | None = None, seconds: float = BUDGET, comm: Any = None
) -> Recommendation | None:
    """What `study recommend` does: find it, print it, write the tuned scene (to NAME.tuned.toml by default). Collective."""
    benchmark = Benchmark(comm)
    with raising_together(benchmark.ranks):
        scene = Scene.load(path)
    same_on_all(benchmark.ranks, scene.to_dict())
    benchmark.screen = Screen(benchmark.ranks.is_root, False)
    found = recommend(benchmark, scene, tolerance, error, seconds)
    target = output or path.with_suffix(".tuned.toml")
    if found:
        report(benchmark.screen, found)
    benchmark.ranks.run_on_root(lambda: save(found, path, target) if found else None)
    benchmark.screen.say(f"written: {target}")
    return found


def save(found: Recommendation, source: Path, target: Path) -> None:
    """Write the tuned scene; on one rank."""
    best = found.best
    remark = (
        f"by study recommend: {found.error} {best.trial.errors[found.error]:.2g} (wanted: {found.tolerance:g}), "
        f"about {best.seconds.median:.2g} s on {found.ranks} rank(s)"
    )
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(written(found.tables, source, target, remark), encoding="utf-8")
    except OSError as error:
        raise SceneError(f"{target}: cannot be written ({error.strerror})") from None
