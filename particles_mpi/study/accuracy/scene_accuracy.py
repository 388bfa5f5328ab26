"""What accuracy costs in a scene of the user's: its settings on a ladder of steps, and what each of its effects costs."""

from __future__ import annotations

from math import nan

from particles_mpi import Scene
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.study.measuring.clock import Watch, time_in_turns
from particles_mpi.study.measuring.experiment import Experiment, Lab, Row, Setting
from particles_mpi.study.recommending.recommend import BUDGET, WORK
from particles_mpi.study.recommending.reference import reference
from particles_mpi.study.recommending.search import Search, Trial
from particles_mpi.study.recommending.settings import curves, own
from particles_mpi.study.recommending.starts import FEW, Start, variant

LADDER = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # times the steps of the scene
QUICK = (0.5, 1.0, 2.0)
TOLERANCES = (1e3, 1e5, 1e7, 1e9)  # of `adaptive`, inverse


def measure(lab: Lab, scene: Scene, seconds: float = BUDGET) -> list[Experiment]:
    """Two experiments: settings of the scene, and its effects left out in turn. Collective; few bodies on rank 0 alone.

    `seconds`: what errors may take; times of the settings that are left come to that again.
    """
    start = Start(lab, scene)
    if start.total > FEW or lab.ranks.size == 1:
        return [settings(start, seconds), effects(start)]
    alone = lab.ranks.run_on_root(lambda: [f(Start(lab.alone(), scene)) for f in (lambda s: settings(s, seconds), effects)])
    return alone or []


def settings(start: Start, seconds: float) -> Experiment:
    """Errors of each integrator, mode or angle over a ladder of steps."""
    lab, answers = start.lab, []
    yardstick = reference(start, seconds)
    if not yardstick.names:
        raise SceneError("particles: nothing in this scene has an error")
    search = Search(start, yardstick, yardstick.names[0], 1.0, 2.0 * seconds / 3.0)
    ladder = QUICK if lab.quick else LADDER
    mine, fineness = own(start)
    search.attempt(mine, fineness)
    for curve in curves(start):
        knobs = TOLERANCES[:: 2 if lab.quick else 1] if curve.adaptive else [k * max(start.scene.steps, 4) for k in ladder]
        for knob in knobs:
            if search.left() < 0.0:
                search.refused[curve.name] = f"not measured further: {seconds:.0f} s are over"
                break
            search.attempt(curve, knob, search.left())
    chosen = [trial for trial in search.trials if all(e == e for e in trial.errors.values())]
    rows = clocked(start, chosen)
    answers += (
        [f"reference: {yardstick.reference}; order seen: {yardstick.order:.2f}"] if yardstick.order == yardstick.order else []
    )
    if yardstick.part < 1.0:
        answers.append(f"errors are those of the first 1/{1 / yardstick.part:.0f} of the run, to t = {yardstick.span:.4g}")
    answers += [f"not compared: {name}: {why}" for name, why in search.refused.items()]
    floor = yardstick.floors[yardstick.names[0]]
    words = {name: MEANING.get(name, f"{name}, relative to that of the reference") for name in yardstick.names}
    title = f"{start.scene.title or 'the scene'}, {start.total} particles"
    what = f"{yardstick.reference}; floor {floor:.1g}: {yardstick.why}"
    return Experiment("S", title, "step or tolerance", words, what, rows, (), floor, answers)


MEANING = {
    "state": "largest distance of any particle from its place, over the size of the motion",
    "energy": "largest relative error of the energy of the run",
}


def clocked(start: Start, trials: list[Trial]) -> list[Row]:
    """Trials as rows, with their times and the orders seen. Collective."""
    lab = start.lab
    told = lab.screen.count("time", len(trials) * (1 + lab.samples))
    chosen = [setting(start, trial) for trial in trials]
    return lab.clocked(chosen, [t.errors for t in trials], [t.work for t in trials], lambda: told("time"))


def setting(start: Start, trial: Trial) -> Setting:
    """A trial as a setting of an experiment."""
    knob = 1.0 / trial.fineness if trial.curve.adaptive else trial.scene.time.step
    begin = lambda: start.simulate(trial.scene)  # noqa: E731
    return Setting(trial.curve.name, knob, begin, trial.scene.steps, lambda sim: trial.errors, trial.curve.adaptive)


def effects(start: Start) -> Experiment:
    """Seconds of a step with all effects, and with each left out in turn, from the same start."""
    scene, lab, answers = start.scene, start.lab, []
    steps = max(4, min(scene.steps, 100))
    names, watches = [], []
    time = scene.time.model_dump(exclude_none=True) | {"steps": steps}
    time.pop("end", None)
    for name in ["", *scene.effects]:
        try:
            less = variant(scene, time, {name: None} if name else {})
            start.simulate(less).step()
        except (SceneError, StoppedError) as error:
            answers.append(f"without {name}: {str(error).splitlines()[0]}")
            continue
        names.append(f"without {name}" if name else "all effects")
        begin = lambda less=less: start.simulate(less)  # noqa: E731
        watches.append(Watch(lab.ranks, begin, steps))
    time_in_turns(watches, lab.samples, lab.least)
    rows, whole = [], watches[0].seconds.median if watches else nan
    for name, watch in zip(names, watches, strict=True):
        share = 1.0 - watch.seconds.median / whole
        one = Setting(name, scene.time.step, watch.begin, 1, lambda sim: {"share": nan})
        rows.append(Row(one, {"share": share}, {"share": nan}, watch.seconds, dict.fromkeys(WORK, 0)))
    answers.append("an effect left out changes the motion too: shares need not add up to 1")
    errors = {"share": "of the seconds of a step that go when the effect does"}
    return Experiment("H", f"What each effect costs a step: {scene.title or 'the scene'}", "step", errors,
                      "the scene with all its effects", rows, (), 0.0, answers)  # fmt: skip
