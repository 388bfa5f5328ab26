"""What accuracy costs in a user's scene: its settings on a ladder of steps, and the cost of each of its effects."""

from functools import partial
from math import isnan, nan

from particles_mpi import Scene
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.parallel.agreement import await_all
from particles_mpi.study.experiment import Benchmark, Experiment, Setting
from particles_mpi.study.recommend.methods import as_it_is, methods
from particles_mpi.study.recommend.reference import reference
from particles_mpi.study.recommend.runs import Start, variant
from particles_mpi.study.recommend.search import BUDGET_SECONDS, Search, time_trials

STEP_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # times the steps of the scene
INVERSE_TOLERANCES = (1e3, 1e5, 1e7, 1e9)  # of `adaptive`, inverse
MEANING = {
    "state": "largest distance of any particle from its true position, at up to 16 times of the run, over the size of the motion",
    "energy": "largest relative error of the energy of the run",
}


def experiments(benchmark: Benchmark, scene: Scene) -> list[Experiment]:
    """Measure the settings of the scene, and its effects switched off in turn. Collective; few bodies on rank 0 alone."""
    try:
        return Start(benchmark, scene).on_few(lambda start: [settings(start), effects(start)]) or []
    finally:
        benchmark.screen.stop()


def settings(start: Start) -> Experiment:
    """Find the errors of each integrator, mode or angle over a ladder of steps, in BUDGET_SECONDS; times take as long again."""
    quick, screen = start.benchmark.quick, start.benchmark.screen
    steps = [k * max(start.scene.steps, 4) for k in (STEP_FACTORS[1:4] if quick else STEP_FACTORS)]
    tolerances = INVERSE_TOLERANCES[:: 2 if quick else 1]
    tried = [(method, float(n)) for method in methods(start) for n in (tolerances if method.adaptive else steps)]
    progress = screen.count("errors", 2 + len(tried))
    progress("reference")
    metric = reference(start, BUDGET_SECONDS)
    if not metric.limits:
        raise SceneError("particles: nothing in this scene has an error that could be measured")
    error, limit = next(iter(metric.limits.items()))  # the most telling
    search = Search(start, metric, {error: 1.0}, 2.0 * BUDGET_SECONDS / 3.0)
    progress("errors of the scene as it is")
    search.attempt(*as_it_is(start))
    for method, resolution in tried:
        progress(f"errors of {method.name}")
        if search.left() < 0.0:
            search.refused[method.name] = f"no further steps measured: the {BUDGET_SECONDS:.0f} s are used up"
        else:
            search.attempt(method, resolution, search.left())
    screen.stop()
    rows = time_trials(start, [trial for trial in search.trials if not any(map(isnan, trial.errors.values()))])
    answers = [f"reference: {metric.reference}; order seen: {metric.order:.2f}"] if not isnan(metric.order) else []
    if metric.part < 1.0:
        answers.append(f"errors are those of the first 1/{1 / metric.part:.0f} of the run, to t = {metric.span:.4g}")
    answers += [f"not compared: {name}: {why}" for name, why in search.refused.items()]
    errors = {name: MEANING.get(name, f"{name}, relative to that of the reference") for name in metric.limits}
    title = f"{start.scene.title or 'the scene'}, {start.total} particles"
    how = f"{metric.reference}; floor {limit:.1g}: {metric.why}"
    return Experiment("S", title, "step or tolerance", errors, how, rows, (), limit, answers)


def effects(start: Start) -> Experiment:
    """Time a step with all effects, and with each switched off in turn, from the same start."""
    scene, answers, tried = start.scene, list[str](), []
    steps = max(4, min(scene.steps, 100))
    for name in ["", *scene.active]:
        try:
            begin = partial(start.simulate, variant(scene, {"steps": steps, "end": None}, {name: {"active": False}}))
            begin().step()
        except (SceneError, StoppedError) as error:
            await_all(start.benchmark.ranks, error)
            answers.append(f"without {name}: {str(error).splitlines()[0]}")
            continue
        curve = f"without {name}" if name else "all effects"
        tried.append(Setting(curve, scene.time.step, begin, steps, lambda sim: {"share": nan}, seconds_of=1))
    answers.append("switching an effect off also changes the motion, so shares need not add up to 1")
    errors = {"share": "share of the seconds of a step that is saved without the effect"}
    title, reference = f"What each effect costs a step: {scene.title or 'the scene'}", "the scene with all its effects"
    found = start.benchmark.compare("H", title, tried, errors, reference, answers=answers)
    for row in found.rows:
        row.errors["share"] = 1.0 - row.seconds.median / found.rows[0].seconds.median
    return found
