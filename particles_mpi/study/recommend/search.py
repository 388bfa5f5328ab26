"""Searches the cheapest resolution of a method that reaches a tolerance: by factors of two, then by the observed order."""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isfinite, log, log2, log10
from time import perf_counter

from particles_mpi import Scene
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.parallel.agreement import await_all
from particles_mpi.study.experiment import Errors, Row, Setting
from particles_mpi.study.recommend.error_metric import ErrorMetric
from particles_mpi.study.recommend.methods import AS_IT_IS, Method
from particles_mpi.study.recommend.runs import LEAST_SNAPSHOTS, Record, Start, TooLongError, apart_all_along, follow
from particles_mpi.study.timing import NOT_TIMED, Seconds

BUDGET_SECONDS = 60.0  # seconds of measuring, about: a third each for the reference, the search, and times
AIMED_SHARE = 0.85  # of the tolerance: what a refined step aims at
MOST_REFINEMENTS = 3
RETIMED_FACTOR = 2.0  # times the seconds of the quickest: settings within this are timed again, by turns
GIVEN_UP_FACTOR = 2.0  # times the seconds of the best: where a method is given up
MOST_REFUSALS = 5  # of settings of a method, one after the other
NEGLIGIBLE_SECONDS = 0.2  # seconds that are no reason to give anything up
COARSEST, FINEST = 1e3, 1e11  # 1/tolerance of `adaptive`
LEAST_GAIN = 1.15  # a finer setting whose error is not smaller by this: something else limits it


@dataclass
class Trial:
    """A setting, tried over the span: its errors, the seconds it took with all snapshots, and its work.

    part: of the run that is the span. timed: seconds of the whole run, output not counted, of those that were compared.
    """

    method: Method
    resolution: float
    scene: Scene
    errors: Errors
    seconds: float
    work: dict[str, int]
    record: Record
    part: float
    timed: Seconds = NOT_TIMED

    @property
    def name(self) -> str:
        return f"{self.method.name}, {self.method.describe(self.resolution, self.part)}"


def time_trials(start: Start, trials: list[Trial], sample_seconds: float | None = None) -> list[Row]:
    """Return rows of trials with times and observed orders; `sample_seconds`: the least seconds of a sample. Collective."""
    benchmark = start.benchmark
    progress = benchmark.screen.count("time", len(trials) * (1 + benchmark.samples))

    def row(trial: Trial) -> Row:
        parameter = 1.0 / trial.resolution if trial.method.adaptive else trial.scene.time.step
        begin, steps = partial(start.simulate, trial.scene), trial.scene.steps
        setting = Setting(trial.method.name, parameter, begin, steps, lambda sim: trial.errors, trial.method.adaptive)
        return Row(setting, trial.errors, trial.work)

    rows = [row(trial) for trial in trials]
    benchmark.time(rows, lambda: progress("time"), sample_seconds)
    return rows


class Search:
    """Tries settings of a scene against an error metric.

    tolerances: what each error may be in the measured part, the most telling one first; tolerance: that of the first one.
    `seconds` is what all of it may take.
    """

    def __init__(self, start: Start, metric: ErrorMetric, tolerances: Errors, seconds: float):
        self.start, self.metric, self.tolerances = start, metric, tolerances
        self.tolerance = next(iter(tolerances.values()))
        self.trials: list[Trial] = []
        self.refused: dict[str, str] = {}  # why settings were not tried, or methods not followed
        self.too_long = False  # was the last one that was refused
        self.best, self.seconds, self.began = inf, seconds, perf_counter()

    @property
    def places(self) -> bool:
        """Are places compared?"""
        return "state" in self.tolerances

    def reached(self, errors: Errors) -> bool:
        """Is each error below its tolerance, even if it is larger by half of the resolution limit?"""
        return all(errors[name] + 0.5 * self.metric.limits[name] <= most for name, most in self.tolerances.items())

    def size(self, errors: Errors) -> float:
        """Return the largest error, scaled so that it is below `tolerance` if each is below its own; inf if one is not finite."""
        parts = [errors[name] / most for name, most in self.tolerances.items()]
        return self.tolerance * max(parts) if all(map(isfinite, parts)) else inf

    def described(self, errors: Errors) -> str:
        """Return these errors, as far as there are tolerances for them, in words."""
        return ", ".join(f"{name} {errors[name]:.2g}" for name in self.tolerances)

    def left(self) -> float:
        """Return the seconds that are left, on the slowest rank. Collective."""
        return self.seconds - self.start.benchmark.ranks.largest(perf_counter() - self.began)[0]

    def patience(self) -> float:
        """Return the seconds that a trial may take: all that are left, if no setting reaches the tolerance yet."""
        return min(max(self.left(), NEGLIGIBLE_SECONDS), max(3.0 * self.best, 5.0 * NEGLIGIBLE_SECONDS))

    def attempt(self, method: Method, resolution: float, patience: float = inf) -> Trial | None:
        """Try a setting; returns None if it is refused, stops, or takes too long. Collective."""
        resolution = resolution if method.adaptive else float(method.whole_steps(resolution, self.metric.part))
        try:
            scene = method.scene(resolution, self.metric.part)
            for earlier in self.trials:
                if earlier.scene == scene:  # the scene as it is, by another name
                    self.trials.append(replace(earlier, method=method, resolution=resolution))
                    return self.trials[-1]
            sim = self.start.simulate(scene)
            before = sim.work()
            record = follow(self.start, sim, self.metric.snapshots, patience)
        except (SceneError, StoppedError) as error:
            await_all(self.start.benchmark.ranks, error)
            self.too_long = isinstance(error, TooLongError)
            why = "more expensive than others, or no time left" if self.too_long else str(error).splitlines()[0]
            self.refused[f"{method.name}, {method.describe(resolution, self.metric.part)}"] = why
            return None
        work = {kind: count - before[kind] for kind, count in sim.work().items()}
        trial = Trial(method, resolution, scene, self.metric.errors(record), record.seconds, work, record, self.metric.part)
        if all(isfinite(error) for error in trial.errors.values()) and self.reached(trial.errors):
            self.best = min(self.best, trial.seconds)
        self.trials.append(trial)
        return trial

    def along(self, method: Method, resolution: float) -> None:
        """Bracket the tolerance by factors from a first setting on, then find where it is just reached. Collective."""
        if not method.adaptive:  # one step first, in which kernels are loaded; `adaptive` has none of its own, and long steps
            with suppress(SceneError, StoppedError):
                self.start.simulate(method.scene(resolution, self.metric.part)).step()
        fine, coarse = self.attempt(method, resolution, self.patience()), None
        while fine is None or not self.reached(fine.errors):
            resolution *= method.ratio
            if not self.worth_it(method, coarse, fine, resolution):
                return
            fine, coarse = self.attempt(method, resolution, self.patience()), fine or coarse
        while coarse is None:
            resolution = fine.resolution / method.ratio
            at_end = resolution < COARSEST if method.adaptive else method.steps(resolution, self.metric.part) == fine.scene.steps
            next_ = None if at_end or self.left() < 0.0 else self.attempt(method, resolution, self.patience())
            if next_ is None:
                return
            fine, coarse = (next_, None) if self.reached(next_.errors) else (fine, next_)
        if not self.metric.means:  # which step is just enough chance decides there
            self.refine(coarse, fine)

    def worth_it(self, method: Method, coarse: Trial | None, fine: Trial | None, resolution: float) -> bool:
        """May a finer setting than these two help and still be the cheapest, and is there time for it?"""
        why = ""
        if fine and coarse and self.size(fine.errors) * LEAST_GAIN > self.size(coarse.errors) and self.size(coarse.errors) < 0.1:
            why = f"shorter steps get no better than {self.described(fine.errors)}"
        elif method.adaptive and resolution > FINEST * 1.01:
            why = f"reaches no better than tolerance {1.0 / FINEST:.0e}"
        elif fine is None:
            tries = sum(name.startswith(method.name) for name in self.refused)
            return not self.too_long and tries < MOST_REFUSALS and self.left() > 0.0
        else:
            seconds = fine.seconds * (1.0 if method.adaptive else method.ratio)
            if seconds > max(GIVEN_UP_FACTOR * self.best, NEGLIGIBLE_SECONDS) or seconds > self.left():
                why = "more expensive than others" if isfinite(self.best) else "no time to try shorter steps"
        if why:
            self.refused[method.name] = why
        return not why

    def refine(self, coarse: Trial, fine: Trial) -> None:
        """Try, between a setting that fails and one that does not, the one that the order between the two predicts."""
        low, high = coarse.resolution, fine.resolution
        more, less = self.size(coarse.errors), self.size(fine.errors)
        if not isfinite(more) or not more > less > 0.0 or self.left() < 0.0:
            return
        order = log(more / less) / log(high / low)
        aim = low * (more / (AIMED_SHARE * self.tolerance)) ** (1.0 / order)
        for _ in range(MOST_REFINEMENTS):
            if not low < aim < 0.97 * high:
                return
            trial = self.attempt(fine.method, aim, self.patience())
            if trial is None or self.reached(trial.errors):
                return
            error = self.size(trial.errors)
            aim *= (error / (AIMED_SHARE * self.tolerance)) ** (1.0 / order) if isfinite(error) else 1.1

    def confirm(self, trial: Trial) -> tuple[Trial, Trial, float] | None:
        """Return (this setting or a finer one, the one at half its step, their distance); None if none is confirmed.

        A setting is confirmed if half the step reaches the tolerance too, and the two are not further apart than the tolerance:
        places in every step, and not at the snapshots only; other errors, which chance is in, twice as far. Collective.
        """
        places, method = self.places, trial.method
        while True:
            kept = len(self.trials)
            finer = self.attempt(method, trial.resolution * method.ratio)
            del self.trials[kept:]
            if finer is None or not self.reached(finer.errors):
                return None
            if places:
                difference = apart_all_along(self.start, trial.scene, finer.scene) / self.metric.size
            else:
                apart = {name: self.metric.difference(name, trial.record, finer.record) for name in self.tolerances}
                difference = self.size(apart)
            if difference <= (1.0 if places else 2.0) * self.tolerance:
                return trial, finer, difference
            if not places or self.left() < 0.0:
                return None
            order = {"order4": 4, "adaptive": 1}.get(method.integrator, 2)
            further = (difference / (AIMED_SHARE * self.tolerance)) ** (1.0 / order)
            method = replace(method, name=method.name.removeprefix(AS_IT_IS))
            next_ = self.attempt(method, trial.resolution * max(LEAST_GAIN, further))
            if next_ is None:
                return None
            trial = next_

    def finalists(self) -> list[Trial]:
        """Return the trials that may be the cheapest: the coarsest of each method that reaches the tolerance.

        With contacts, whose cost depends on the step in other ways, they are the two quickest.
        """
        found, contacts = [], "collisions" in self.start.scene.effects
        for method in {id(trial.method): trial.method for trial in self.trials}.values():
            good = [t for t in self.trials if t.method is method and self.reached(t.errors)]
            found += sorted(good, key=lambda t: t.seconds if contacts else t.resolution)[: 1 + contacts]
        quickest = min((trial.seconds for trial in found), default=inf)
        return [trial for trial in found if trial.seconds <= max(RETIMED_FACTOR * quickest, NEGLIGIBLE_SECONDS)]

    def first(self, method: Method, own: Trial | None) -> float:
        """Return the resolution at which a method begins, from the errors of the scene's own setting and from orders."""
        if method.adaptive:
            return float(10.0 ** min(max(round(-0.5 * log10(self.tolerance)) + 2, 3), 9))
        steps = float(max(self.start.scene.steps, LEAST_SNAPSHOTS))
        order = {"leapfrog": 2, "order4": 4}.get(method.integrator, 1)
        if "collisions" in self.start.scene.effects:
            return steps
        if own and own.method.integrator == method.integrator and 0.0 < self.size(own.errors) < 1.0:
            better = log2(self.size(own.errors) / self.tolerance) / order
            return steps * 2.0 ** min(max(round(better), -6), 6)
        return steps / 4.0 if order == 4 else steps
