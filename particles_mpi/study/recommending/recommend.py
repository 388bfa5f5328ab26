"""The cheapest setting of a scene that reaches a tolerance: searched, timed fairly, verified at half the step, written down."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite, nan
from pathlib import Path
from time import perf_counter
from typing import Any

from rich.table import Table

from particles_mpi import Scene
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.parallel.agreement import raising_together, same_on_all
from particles_mpi.run.console import Screen
from particles_mpi.study.measuring.clock import Seconds, Watch, time_in_turns
from particles_mpi.study.measuring.experiment import Errors, Lab
from particles_mpi.study.recommending.error_metric import Yardstick, observables
from particles_mpi.study.recommending.reference import reference
from particles_mpi.study.recommending.search import Search, Trial, first
from particles_mpi.study.recommending.settings import Curve, curves, own
from particles_mpi.study.recommending.starts import FEW, Start
from particles_mpi.study.recommending.tracks import apart
from particles_mpi.study.recommending.tuned import Tables, tuned, written

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
    """`best`: the cheapest setting measured that reaches the tolerance for `error`. `tables`: the tuned scene.

    `half`: its errors at half the step (`adaptive`: a tenth of the tolerance), `difference` between the two runs; `timed`: all
    that were compared; `own`: the scene as it is; `dropped`: settings that half the step did not confirm.
    """

    tolerance: float
    error: str
    best: Timed
    steps: int
    tables: Tables
    half: Errors
    difference: float
    timed: list[Timed]
    own: Trial | None
    yardstick: Yardstick
    trials: list[Trial]
    refused: dict[str, str]
    ranks: int
    took: float = nan
    dropped: list[str] = field(default_factory=list)


def recommend(lab: Lab, scene: Scene, tolerance: float, error: str = "", seconds: float = BUDGET) -> Recommendation | None:
    """Find it. Collective; a few bodies are computed on rank 0 alone, and other ranks get None.

    SceneError if the tolerance cannot be measured, StoppedError if nothing in these seconds reaches it.
    """
    if not 0.0 < tolerance < 1.0:
        raise SceneError(f"--tolerance {tolerance:g}: must be above 0 and below 1")
    start = Start(lab, scene)
    try:
        if start.total > FEW or lab.ranks.size == 1:
            return found(start, tolerance, error, seconds)
        result: Recommendation | None = lab.ranks.run_on_root(lambda: found(Start(lab.alone(), scene), tolerance, error, seconds))
        return result
    finally:
        lab.screen.stop()


def found(start: Start, tolerance: float, error: str, seconds: float) -> Recommendation:
    """The same, on the ranks of the start's lab."""
    lab, began = start.lab, perf_counter()
    told = lab.screen.count("recommend", 1 + len(curves(start)))
    told("reference")
    yardstick = reference(start, seconds, error)
    error = chosen(yardstick, tolerance, error)
    search = Search(start, yardstick, error, tolerance * share(yardstick, error), seconds / 3.0)
    mine = search.attempt(*own(start))
    for curve in in_order(start, lost=mine is None or mine.errors[error] > LOST):
        told(f"search: {curve.name}")
        search.along(curve, first(curve, search, mine))
    lab.screen.stop()
    finalists = search.finalists()
    if not finalists:
        raise StoppedError(f"--tolerance {tolerance:g}: not reached in {seconds:.0f} s of measuring: " + nearest(search))
    timed = sorted(clocked(start, finalists, yardstick), key=lambda one: one.seconds.median)
    dropped: list[str] = []
    for one in timed:
        half, difference = verified(search, one.trial)
        if half and search.reached(half) and difference <= 2.0 * search.tolerance:
            break
        dropped.append(one.trial.name)
    else:
        raise StoppedError(f"--tolerance {tolerance:g}: reached by chance only: half the step does not confirm " + dropped[0])
    steps = one.trial.curve.steps(one.trial.fineness, 1.0)
    tables = tuned(start.scene, one.trial.scene, steps)
    took = float(lab.ranks.allreduce_max(perf_counter() - began)[0])
    trials = [trial for trial in search.trials if trial.track is not None]
    return Recommendation(tolerance, error, one, steps, tables, half, difference, timed, mine, yardstick, trials,
                          search.refused, lab.ranks.size, took, dropped)  # fmt: skip


def share(yardstick: Yardstick, error: str) -> float:
    """Of the tolerance, for a part of the run: places go astray evenly at best, rates and energies do not grow."""
    return yardstick.part if error == "state" else 1.0


def in_order(start: Start, lost: bool) -> list[Curve]:
    """Curves, first those that are likely the cheapest: what is reached early cuts the others short. `lost`: as it is the scene
    is so wrong that only `adaptive` is sure to get through."""
    order = {"order4": 1, "adaptive": 0 if lost else 2, "leapfrog": 3, "taylor": 4}
    return sorted(curves(start), key=lambda curve: order[curve.integrator])


def chosen(yardstick: Yardstick, tolerance: float, error: str) -> str:
    """The error that the tolerance is for; SceneError where it cannot be measured, or not so finely."""
    error = error or (yardstick.names or [""])[0]
    if error not in yardstick.floors:
        there = "; ".join(yardstick.names) or "none"
        raise SceneError(f"--error {error or 'any'}: cannot be measured here ({yardstick.why}); there are: {there}")
    floor = yardstick.floors[error] / share(yardstick, error)
    if tolerance < floor:
        raise SceneError(f"--tolerance {tolerance:g} is below what can be measured here: {error} {floor:.1g} ({yardstick.why})")
    return error


def nearest(search: Search) -> str:
    """The best of what was tried."""
    tried = [trial for trial in search.trials if isfinite(trial.errors[search.error])]
    if not tried:
        return "; ".join(f"{name}: {why}" for name, why in search.refused.items())
    best = min(tried, key=lambda trial: trial.errors[search.error])
    return f"the best is {best.name}, {search.error} {best.errors[search.error]:.2g}"


def clocked(start: Start, trials: list[Trial], yardstick: Yardstick) -> list[Timed]:
    """Seconds of the whole run for each, by turns. Collective."""
    lab, quick = start.lab, all(trial.seconds < SHORT for trial in trials)
    watches = []
    for trial in trials:
        begin = lambda scene=trial.scene: start.simulate(scene)  # noqa: E731
        watches.append(Watch(lab.ranks, begin, trial.scene.steps, by_forces=trial.curve.adaptive))
    time_in_turns(watches, lab.samples, min(lab.least, SHORT) if quick else lab.least)
    units = [(trial.work["forces"] if trial.curve.adaptive else trial.scene.steps) / yardstick.part for trial in trials]
    return [Timed(trial, watch.seconds.of(round(n))) for trial, watch, n in zip(trials, watches, units, strict=True)]


def verified(search: Search, trial: Trial) -> tuple[Errors, float]:
    """(errors at half the step, difference between the two runs), the latter in the units of the error. Collective."""
    before = len(search.trials)
    finer = search.attempt(trial.curve, trial.fineness * trial.curve.ratio)
    del search.trials[before:]
    if finer is None:
        return {}, nan
    return finer.errors, between(search, trial, finer)


def between(search: Search, one: Trial, other: Trial) -> float:
    """How far two runs are apart, as the error is measured."""
    yardstick, error = search.yardstick, search.error
    if error == "state":
        return apart(one.track.places, other.track.places, yardstick.start.length) / yardstick.size
    if error == "energy":
        return abs(one.errors[error] - other.errors[error])
    first, second = observables(one.track)[error], observables(other.track)[error]
    return abs(first - second) / yardstick.scales[error]


def report(screen: Screen, found: Recommendation) -> None:
    """All of it on the screen."""
    yard, error, best = found.yardstick, found.error, found.best
    scene, whole = yard.start.scene, yard.part == 1.0
    say = screen.say
    say(f"[bold]{scene.title or 'untitled scene'}[/bold]: {yard.start.total} particles, {error} to {found.tolerance:g}")
    say(f"  reference: {yard.reference}; {error} can be measured down to {yard.floors[error]:.1g} ({yard.why})")
    if not whole:
        say(
            f"  [yellow]errors are those of the first 1/{1 / yard.part:.0f} of the run (t = {yard.span:.4g})[/yellow]: "
            f"a reference of all of it would take too long; {error} is held to {found.tolerance * share(yard, error):.2g} there"
        )
    works = [name for name in WORK if any(trial.work[name] for trial in found.trials)]
    table = Table("setting", *yard.names, "seconds", *(WORK[name] for name in works), box=None, padding=(0, 1, 0, 1))
    for column in table.columns:
        column.no_wrap = True
    times = {id(one.trial): one.seconds for one in found.timed}
    for trial in sorted(found.trials, key=lambda t: (t.curve.name, t.fineness)):
        s = times.get(id(trial))
        seconds = f"{s.median:.3g} ({s.low:.3g}-{s.high:.3g})" if s else ""
        errors, work = (f"{trial.errors[name]:.2g}" for name in yard.names), (str(trial.work[name]) for name in works)
        table.add_row(trial.name, *errors, seconds, *work, style="bold" if trial is best.trial else None)
    say(table)
    for name, why in found.refused.items():
        say(f"  {name}: {why}")
    for name in found.dropped:
        say(f"  {name}: reaches it by chance, not at half the step")
    finer = "a tenth of the tolerance" if best.trial.curve.adaptive else "half the step"
    say(f"[bold]recommended: {best.trial.curve.name}, {found.steps} steps of {scene.steps * scene.time.step / found.steps:.6g}"
        f"{', ' + best.trial.curve.words(best.trial.fineness) if best.trial.curve.adaptive else ''}[/bold]: {error} "
        f"{best.trial.errors[error]:.2g}; the whole run takes {best.seconds.median:.3g} s ({best.seconds.low:.3g} to "
        f"{best.seconds.high:.3g}) on {found.ranks} rank(s), output not counted")  # fmt: skip
    say(f"  verified at {finer}: {error} {found.half[error]:.2g}, the two runs differ by {found.difference:.2g}")


def recommend_scene(
    path: Path, tolerance: float, error: str = "", output: Path | None = None, seconds: float = BUDGET, comm: Any = None
) -> Recommendation | None:
    """What `study recommend` does: find it, tell it, write the tuned scene (to NAME.tuned.toml by default). Collective."""
    lab = Lab(comm)
    with raising_together(lab.ranks):
        scene = Scene.load(path)
    same_on_all(lab.ranks, scene.to_dict())
    lab.screen = Screen(lab.ranks.is_root, False)
    found = recommend(lab, scene, tolerance, error, seconds)
    target = output or path.with_suffix(".tuned.toml")
    if found:
        report(lab.screen, found)
    lab.ranks.run_on_root(lambda: save(found, path, target) if found else None)
    lab.screen.say(f"written: {target}")
    return found


def save(found: Recommendation, source: Path | None, target: Path) -> None:
    """Write the tuned scene."""
    best = found.best
    remark = (f"by study recommend: {found.error} {best.trial.errors[found.error]:.2g} (wanted: {found.tolerance:g}), "
              f"about {best.seconds.median:.2g} s on {found.ranks} rank(s)")  # fmt: skip
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(written(found.tables, source, target, remark), encoding="utf-8")
    except OSError as error:
        raise SceneError(f"{target}: cannot be written ({error.strerror})") from None
