"""The command line. Exit codes: 0 done, 2 bad scene or arguments, 3 stopped by the run, 130 interrupted."""

import gc
import os
import sys
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer
from mpi4py import MPI
from typer.core import TyperGroup

from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.parallel.agreement import abort_all, raising_together, same_on_all
from particles_mpi.parallel.communicator import Communicator

STARTED = perf_counter()
app = typer.Typer(
    name="particles-mpi",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="""Moving, colliding particles in any dimension, on any number of MPI ranks: the same bits on all of them.

    A first run:   [bold]mpirun -n 2 particles-mpi run particles_mpi/scenes/marbles.toml --output out/marbles[/bold]

    A scene file says what there is (particles, box) and which effects act; an effect that it does not name does not run.
    [bold]check[/bold] tells what a scene would do before it runs, and what is wrong with it, key by key.""",
)

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE.toml", help="The scene: see particles_mpi/scenes/ for examples.")]
AnyScene = Annotated[Path | None, typer.Argument(metavar="[SCENE.toml]", help="A scene of yours; else the built-in set.")]
Folder = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for report, pictures and CSV files.")]
Quick = Annotated[bool, typer.Option("--quick", help="A look within a minute: fewer settings, short samples.")]
STOPPING = "Write a checkpoint and stop within this time; if not given, before the limit of a Slurm job; none: without a limit."
WallTime = Annotated[str | None, typer.Option(metavar="HH:MM:SS", help=STOPPING)]
RESULTS = "Folder for the results; out/<scene name> if not given."
RESUMING = "Go on from this checkpoint.h5, on any number of ranks; auto: from the folder's own, or else from the start."
TunedFile = Annotated[Path | None, typer.Option(metavar="TUNED.toml", help="The tuned scene; NAME.tuned.toml if not given.")]
IS_ROOT = MPI.COMM_WORLD.Get_rank() == 0


@app.command()
def run(
    scene: SceneFile,
    output: Annotated[Path | None, typer.Option("--output", "-o", help=RESULTS)] = None,
    steps: Annotated[int | None, typer.Option(min=0, help="Stop after this many steps instead of at the scene's end.")] = None,
    resume: Annotated[Path | None, typer.Option(help=RESUMING)] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run that the folder holds.")] = False,
    wall_time: WallTime = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing but errors.")] = False,
) -> None:
    """Run a scene: frames for ParaView, diagnostics, checkpoints; then the phase table.

    Example:   mpirun -n 2 particles-mpi run my.toml --output out/my --steps 100
    """
    from particles_mpi.output.run_folder import changed, to_go_on
    from particles_mpi.run.job import Job
    from particles_mpi.simulation import Simulation

    limit, note = stop_after(wall_time)
    described = load(scene, quiet)
    folder, auto = output or Path("out") / scene.stem, str(resume) == "auto"
    if auto:
        if overwrite:
            raise SceneError("--overwrite: either this, or --resume auto")
        resume = to_go_on(folder, Communicator(), described.to_dict())
        overwrite = resume is None  # a run that was ended before its first checkpoint
    if resume:
        sim = Simulation.resume(resume)
        other = [f"{scene}: {key}: not as in {resume}, which goes on with the scene that it began with"
                 for key in changed(sim.scene.to_dict(), described.to_dict())]  # fmt: skip
        if other:
            raise SceneError(other)
        sim.scene = described  # it may end later, or write more often
    else:
        sim = Simulation(described)
    if auto and sim.steps_done >= (last := sim.last_step if steps is None else steps):
        if IS_ROOT and not quiet:
            print(f"{folder}: step {sim.steps_done} of {last}: nothing is left to do")
        return
    collect_garbage()
    notes = [line for line in (note, f"goes on from step {sim.steps_done}" if resume else "") if line]
    how: dict[str, Any] = {"quiet": quiet, "overwrite": overwrite, "steps": steps, "wall_time": limit, "setup_began": STARTED}
    Job(sim, folder, resumed=resume is not None, notes=notes, scene_file=scene, **how).run()


@app.command()
def check(scene: SceneFile) -> None:
    """Validate a scene, print its plan, and predict from a few steps what it costs and how wrong it is: 0 valid, 2 invalid.

    Example:   particles-mpi check my.toml
    """
    from particles_mpi.run.console import Screen
    from particles_mpi.scene.plan import plan
    from particles_mpi.study.experiment import Benchmark
    from particles_mpi.study.recommend.predict import predict
    from particles_mpi.study.recommend.runs import Start

    described, screen = load(scene, quiet=False), Screen(IS_ROOT, False)
    try:
        start = Start(Benchmark(), described)
    except SceneError as error:
        raise SceneError([f"{scene}: {fault}" for fault in error.faults]) from None
    screen.plan(described.title, plan(described, start.particles, start.total, MPI.COMM_WORLD.Get_size()), start.warnings)
    found = predict(start)
    if found.forecast:
        screen.forecast(found.forecast)
        screen.shares(found.forecast)
    for line in (*(f"  {error}" for error in found.errors), "valid"):
        screen.say(line)


class Studies(TyperGroup):
    """`study SCENE.toml` is `study accuracy SCENE.toml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, ["accuracy", *args] if args and args[0].endswith(".toml") else args)


study = typer.Typer(
    cls=Studies,
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="""Measure the program itself, here and now: what accuracy costs, what a scene needs, how it scales, what stays right.

    [bold]study SCENE.toml[/bold] is short for [bold]study accuracy SCENE.toml[/bold].""",
)
app.add_typer(study, name="study")


@study.command("accuracy")
def accuracy(
    scene: AnyScene = None,
    only: Annotated[str, typer.Option(metavar="LETTERS", help="Only these experiments of the built-in set, as in AC.")] = "",
    quick: Quick = False,
    output: Folder = None,
) -> None:
    """What accuracy costs: error against seconds and work, for a scene or the built-in problems.

    A orbits, B close encounters, C hard-sphere fluid, D tree, F softening, G drag and friction, H effects on and off, I contacts
    that last, J rough spheres.

    Example:   ./run.sh study accuracy --quick
    """
    from particles_mpi.study.accuracy.command import accuracy as measure

    described = load(scene) if scene else None
    if described and only:
        raise SceneError("--only: chooses among the built-in experiments, not with a scene")
    measure(described, only, quick, output or Path("out/study") / (scene.stem if scene else "accuracy"))


@study.command("recommend")
def recommend(
    scene: SceneFile,
    tolerance: Annotated[float, typer.Option(help="Error that is allowed, relative.")],
    error: Annotated[str, typer.Option(metavar="NAME", help="Of what: state, energy, ... (default: the strictest).")] = "",
    output: TunedFile = None,
    seconds: Annotated[float, typer.Option(min=1.0, help="About how long to measure.")] = 60.0,
) -> None:
    """The cheapest setting of a scene that reaches a tolerance: measured, verified at half the step, written as a scene.

    Example:   ./run.sh study recommend my.toml --tolerance 1e-6
    """
    from particles_mpi.study.recommend.recommend import recommend_scene

    recommend_scene(scene, tolerance, error, output, seconds)


@study.command("scaling")
def scaling(
    scene: Annotated[Path | None, typer.Argument(metavar="[SCENE.toml]", help="A scene of yours; else headline.toml.")] = None,
    quick: Quick = False,
    output: Folder = None,
    counts: Annotated[
        bool, typer.Option("--counts", help="Only what ranks send and hold: ranks may be more than cores.")
    ] = False,
) -> None:
    """Strong and weak scaling over 1, 2, 4 ... ranks of this start, phases, and a model of more ranks.

    Example:   RANKS=4 ./run.sh study scaling my.toml,   RANKS=32 ./run.sh study scaling --counts
    """
    from particles_mpi.study.scaling.counted import count
    from particles_mpi.study.scaling.measure import scale

    described, folder = load(scene) if scene else None, output or Path("out/study/scaling") / (scene.stem if scene else "")
    (count if counts else scale)(described, folder, quick)


@study.command("hard-cases")
def hard_cases(
    only: Annotated[str | None, typer.Option(metavar="TEXT", help="Only cases with this in their name, long ones too.")] = None,
    full: Annotated[bool, typer.Option("--full", help="Also the cases that take many minutes: beds of 10 000 for 10 s.")] = False,
    output: Annotated[Path | None, typer.Option(metavar="FILE.json", help="The outcomes as JSON.")] = None,
) -> None:
    """What goes wrong in naive programs, and what must hold here; exit code 3 if something does not.

    Example:   ./run.sh study hard-cases --only column
    """
    from particles_mpi.study.hard_cases.catalogue import study as run_catalogue

    if not run_catalogue(only, full, output):
        raise StoppedError("hard cases: not all that must hold does")


@app.command()
def view(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run, which may be going on.")],
    no_open: Annotated[bool, typer.Option("--no-open", help="Only write the page.")] = False,
) -> None:
    """Write DIR/view.html, a page with the run in it that needs no network, and open it where there is a desktop.

    Example:   particles-mpi view out/marbles
    """
    import webbrowser

    from particles_mpi.results.page import write_page
    from particles_mpi.results.run import Run

    if not IS_ROOT:
        return
    path = write_page(Run(folder))
    print(f"{path} ({path.stat().st_size / 1e6:.1f} MB)")
    if not no_open and (sys.platform in ("darwin", "win32") or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys()):
        webbrowser.open(path.resolve().as_uri())


@app.command()
def doctor() -> None:
    """What is installed (MPI, parallel HDF5, versions), a 2-rank check, and what to do about what is not right."""
    from particles_mpi.run import doctor as examined

    raise SystemExit(examined.main(IS_ROOT, MPI.COMM_WORLD.Get_size()))


def stop_after(wall_time: str | None) -> tuple[float | None, str]:
    """Seconds since STARTED after which a run stops, and a line about a limit that the user did not give. Collective."""
    from particles_mpi.run.scheduler import seconds, slurm_limit

    if wall_time is None:
        limit, note = slurm_limit() if IS_ROOT else (None, "")
        limit, note = Communicator().bcast((None if limit is None else limit + perf_counter() - STARTED, note))
        return limit, note
    try:
        return None if wall_time == "none" else seconds(wall_time), ""
    except ValueError:
        raise SceneError(f"--wall-time: {wall_time!r} is not HH:MM:SS") from None


def load(path: Path, quiet: bool = True) -> Any:
    """The scene of a file: the same on all ranks, or refused. Collective. Unless `quiet` it is told if kernels are compiled."""
    from particles_mpi.run.console import tell_of_compiling
    from particles_mpi.scene.schema import Scene

    ranks = Communicator()
    with raising_together(ranks):
        described = Scene.load(path)
    same_on_all(ranks, described.to_dict())
    if IS_ROOT and not quiet:
        tell_of_compiling(described.dimension)
    return described


def words(arguments: list[str]) -> str:
    """The command line without the names of files: those may differ from rank to rank, what is in them may not."""
    return " ".join("FILE" if "/" in word or word.endswith((".toml", ".h5", ".json")) else word for word in arguments)


def collect_garbage() -> None:
    """From now on Python looks for cycles of objects that nobody needs, but not among those that are there already."""
    gc.freeze()
    gc.enable()


def main() -> None:
    """Run the command; what goes wrong on any rank ends all, with one line and the exit code of the error.

    `__main__` has switched off the search for garbage: `run` begins it before its first step, all other commands here. When
    the process ends, everything is taken as needed: to find out what is not would take a sixth of a short run.
    """
    code: Any = 0
    if sys.argv[1:2] != ["run"]:
        collect_garbage()
    try:
        same_on_all(Communicator(), {"arguments": words(sys.argv[1:])})
        app(standalone_mode=False, prog_name="particles-mpi")
    except typer.Exit as error:
        code = error.exit_code
    except SystemExit as error:
        code = error.code or 0
    except BaseException as error:
        wrong_arguments = getattr(error, "format_message", None)  # typer's own
        code = abort_all(SceneError(wrong_arguments()) if wrong_arguments else error)
    sys.stdout.flush()
    gc.freeze()
    sys.exit(code)
