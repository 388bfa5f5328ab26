"""The search along a curve of settings for the cheapest that reaches a tolerance: by factors of two, then by the order seen."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf, isfinite, log, log2, log10
from time import perf_counter

from particles_mpi import Scene
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.study.measuring.experiment import Errors
from particles_mpi.study.recommending.error_metric import Yardstick
from particles_mpi.study.recommending.settings import Curve
from particles_mpi.study.recommending.starts import Start
from particles_mpi.study.recommending.tracks import LOOKS, TooLongError, Track, follow

MARGIN = 0.85  # of the tolerance: what a refined step aims at
TRIES = 3  # of refinement
CLOSE = 2.0  # times the seconds of the quickest, as they were seen once: those are timed well
DEARER = 2.0  # times the seconds of the best: where a curve is given up
MOST_REFUSALS = 5  # of settings of a curve, one after the other
LITTLE = 0.2  # seconds that are no reason to give anything up
COARSEST, FINEST = 1e3, 1e11  # 1/tolerance of `adaptive`
STALLED = 1.15  # a finer setting whose error is not smaller by this: something else limits it


@dataclass
class Trial:
    """A setting, tried over the span: its errors, the seconds it took with all looks, and its work."""

    curve: Curve
    fineness: float
    scene: Scene
    errors: Errors
    seconds: float
    work: dict[str, int]
    track: Track

    @property
    def name(self) -> str:
        return f"{self.curve.name}, {self.curve.words(self.fineness)}"


class Search:
    """Tries settings of a scene against a yardstick; `seconds` is what all of it may take."""

    def __init__(self, start: Start, yardstick: Yardstick, error: str, tolerance: float, seconds: float):
        self.start, self.yardstick, self.error, self.tolerance = start, yardstick, error, tolerance
        self.trials: list[Trial] = []
        self.refused: dict[str, str] = {}  # why settings were not tried, or curves not followed
        self.too_long = False  # was the last one that was refused
        self.best, self.seconds, self.began = inf, seconds, perf_counter()

    def reached(self, errors: Errors) -> bool:
        """Is the error below the tolerance, however the floor lies?"""
        return errors[self.error] + 0.5 * self.yardstick.floors[self.error] <= self.tolerance

    def left(self) -> float:
        """Seconds, on the slowest rank. Collective."""
        return self.seconds - float(self.start.lab.ranks.allreduce_max(perf_counter() - self.began)[0])

    def patience(self) -> float:
        """Seconds that a trial may take: with no setting that reaches the tolerance all that are left."""
        return min(max(self.left(), LITTLE), max(3.0 * self.best, 5.0 * LITTLE))

    def attempt(self, curve: Curve, fineness: float, patience: float = inf) -> Trial | None:
        """Try a setting; None where it is refused, or stops, or takes too long. Collective."""
        part = self.yardstick.part
        try:
            scene = curve.scene(fineness, part)
            for known in self.trials:
                if known.scene == scene:  # the scene as it is, by another name
                    self.trials.append(replace(known, curve=curve, fineness=fineness))
                    return self.trials[-1]
            sim = self.start.simulate(scene)
            before = sim.work()
            track = follow(self.start, sim, patience)
        except (SceneError, StoppedError) as error:
            self.too_long = isinstance(error, TooLongError)
            why = "dearer than others, or no time left" if self.too_long else str(error).splitlines()[0]
            self.refused[f"{curve.name}, {curve.words(fineness)}"] = why
            return None
        work = {what: count - before[what] for what, count in sim.work().items()}
        trial = Trial(curve, fineness, scene, self.yardstick.errors(track), track.seconds, work, track)
        if all(isfinite(error) for error in trial.errors.values()) and self.reached(trial.errors):
            self.best = min(self.best, trial.seconds)
        self.trials.append(trial)
        return trial

    def along(self, curve: Curve, fineness: float) -> None:
        """Bracket the tolerance by factors from a first setting on, then go to where it is just reached. Collective."""
        self.warm_up(curve, fineness)
        fine = self.attempt(curve, fineness, self.patience())
        coarse: Trial | None = None
        while fine is None or not self.reached(fine.errors):
            if fine is not None and coarse is not None and self.stalled(coarse, fine):
                self.refused[curve.name] = f"no better by shorter steps than {self.error} {fine.errors[self.error]:.2g}"
                return
            coarse, fineness = fine or coarse, fineness * curve.ratio
            if not self.worth_it(curve, fine, fineness):
                return
            fine = self.attempt(curve, fineness, self.patience())
        while coarse is None:
            fineness = fine.fineness / curve.ratio
            at_end = fineness < COARSEST if curve.adaptive else curve.steps(fineness, self.yardstick.part) == fine.scene.steps
            next_ = None if at_end or self.left() < 0.0 else self.attempt(curve, fineness, self.patience())
            if next_ is None:
                return
            fine, coarse = (next_, None) if self.reached(next_.errors) else (fine, next_)
        if self.yardstick.kind != "ensemble":  # which step is just enough chance decides there
            self.refine(coarse, fine)

    def warm_up(self, curve: Curve, fineness: float) -> None:
        """A step that nobody times: kernels are compiled or loaded in it. Collective."""
        if not curve.adaptive:  # a step of which is a frame; it has no kernels of its own
            with suppress(SceneError, StoppedError):
                self.start.simulate(curve.scene(fineness, self.yardstick.part)).step()

    def stalled(self, coarse: Trial, fine: Trial) -> bool:
        """Does a finer setting not help?"""
        return fine.errors[self.error] * STALLED > coarse.errors[self.error] and coarse.errors[self.error] < 0.1

    def worth_it(self, curve: Curve, last: Trial | None, fineness: float) -> bool:
        """May a finer setting still be the cheapest, and is there time for it?"""
        if curve.adaptive and fineness > FINEST * 1.01:
            self.refused[curve.name] = f"reaches no better than tolerance {1.0 / FINEST:.0e}"
            return False
        if last is None:
            tries = sum(name.startswith(curve.name) for name in self.refused)
            return not self.too_long and tries < MOST_REFUSALS and self.left() > 0.0
        next_ = last.seconds * (1.0 if curve.adaptive else curve.ratio)
        if next_ > max(DEARER * self.best, LITTLE) or next_ > self.left():
            self.refused[curve.name] = "dearer than others" if isfinite(self.best) else "no time to try shorter steps"
            return False
        return True

    def refine(self, coarse: Trial, fine: Trial) -> None:
        """Between a setting that fails and one that does not, the one that the order between the two predicts."""
        e, low, high = self.error, coarse.fineness, fine.fineness
        if not isfinite(coarse.errors[e]) or not coarse.errors[e] > fine.errors[e] > 0.0 or self.left() < 0.0:
            return
        order = log(coarse.errors[e] / fine.errors[e]) / log(high / low)
        aim = low * (coarse.errors[e] / (MARGIN * self.tolerance)) ** (1.0 / order)
        for _ in range(TRIES):
            if not low < aim < 0.97 * high:
                return
            trial = self.attempt(fine.curve, aim, self.patience())
            if trial is None or self.reached(trial.errors):
                return
            aim *= (trial.errors[e] / (MARGIN * self.tolerance)) ** (1.0 / order) if isfinite(trial.errors[e]) else 1.1

    def finalists(self) -> list[Trial]:
        """Those that may be the cheapest: the coarsest of each curve that reaches the tolerance, two where cost is not plain."""
        found = []
        for curve in {id(trial.curve): trial.curve for trial in self.trials}.values():
            good = [t for t in self.trials if t.curve is curve and self.reached(t.errors)]
            if curve.monotone:
                found += sorted(good, key=lambda t: t.fineness)[:1]
            else:
                found += sorted(good, key=lambda t: t.seconds)[:2]
        quickest = min((trial.seconds for trial in found), default=inf)
        return [trial for trial in found if trial.seconds <= max(CLOSE * quickest, LITTLE)]


def first(curve: Curve, search: Search, own: Trial | None) -> float:
    """Where the search on a curve begins: by what is known of the scene as it is, and of orders."""
    tolerance = search.tolerance
    if curve.adaptive:
        return float(10.0 ** min(max(round(-0.5 * log10(tolerance)) + 2, 3), 9))
    steps = float(max(curve.start.scene.steps, LOOKS))
    order = {"leapfrog": 2, "order4": 4}.get(curve.integrator, 1)
    if "collisions" in curve.start.scene.effects:
        return steps
    if own and own.curve.integrator == curve.integrator and 0.0 < own.errors[search.error] < 1.0:
        better = log2(own.errors[search.error] / tolerance) / order
        return steps * 2.0 ** min(max(round(better), -6), 6)
    return steps / 4.0 if order == 4 else steps
