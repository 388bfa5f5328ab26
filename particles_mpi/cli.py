"""The command line. Exit codes: 0 done, 2 bad scene or arguments, 3 stopped by the run, 130 interrupted; 1 is of `doctor`."""

import gc
import os
import sys
from contextlib import nullcontext, redirect_stdout
from io import StringIO
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer
from mpi4py import MPI

import particles_mpi
from particles_mpi.errors import SceneError, StateError, StoppedError
from particles_mpi.parallel.agreement import abort_all, same_on_all
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.run.scene_file import SceneFile, given_path, load
from particles_mpi.study.commands import study

STARTED = perf_counter()
IS_ROOT = MPI.COMM_WORLD.Get_rank() == 0

app = typer.Typer(
    name="particles-mpi",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="""Simulate moving, colliding particles in any dimension, on any number of MPI ranks, with the same bits on all of them.

    A first run:   [bold]mpirun -n 2 particles-mpi run particles_mpi/scenes/marbles.toml --output out/marbles[/bold]

    A scene file describes particles and box, and names the effects that act; an effect that it does not name does not run.
    [bold]check[/bold] shows what a scene will do before you run it, and lists what is wrong with it, key by key.""",
)


def print_version(wanted: bool) -> None:
    """Print the version, and end."""
    if wanted:
        if IS_ROOT:
            print(f"particles-mpi {particles_mpi.__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[bool, typer.Option("--version", callback=print_version, is_eager=True, help="Show the version.")] = False,
) -> None:
    """What can be said before a command. The help of `app` is shown instead of this."""


STOPPING = "Write a checkpoint and stop within this time (default: before the time limit of a Slurm job; none: no limit)."
WallTime = Annotated[str | None, typer.Option(metavar="HH:MM:SS", help=STOPPING)]
RESULTS = "Folder for the results (default: out/<scene name>)."
RESUMING = "Continue from this checkpoint.h5, on any number of ranks; auto: from the output folder's, or from the start."


@app.command()
def run(
    scene: SceneFile,
    output: Annotated[Path | None, typer.Option("--output", "-o", parser=given_path, metavar="PATH", help=RESULTS)] = None,
    steps: Annotated[int | None, typer.Option(min=0, help="Number of the last step, instead of that of the scene.")] = None,
    resume: Annotated[Path | None, typer.Option(parser=given_path, metavar="PATH", help=RESUMING)] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run that is in the folder.")] = False,
    wall_time: WallTime = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Run a scene: write frames for ParaView, diagnostics and checkpoints; then print the phase table.

    Example:   mpirun -n 2 particles-mpi run my.toml --output out/my --steps 100
    """
    from particles_mpi.output.run_folder import changed_keys, checkpoint_to_continue, has_ended
    from particles_mpi.run.job import Job
    from particles_mpi.simulation import Simulation

    limit, note = stop_after(wall_time)
    described = load(scene, quiet)
    folder, auto = output or Path("out") / scene.stem, str(resume) == "auto"
    if auto:
        if overwrite:
            raise SceneError("--overwrite: cannot be combined with --resume auto")
        resume = checkpoint_to_continue(folder, Communicator(), described.to_dict())
        overwrite = resume is None  # a run that was ended before its first checkpoint
    if resume:
        files = {name: options.file for name, options in described.outside.items()}
        sim = Simulation.resume(resume, files=files)
        other = [f"{scene}: {key}: differs from {resume}; a run is continued with the scene that it began with"
                 for key in changed_keys(sim.scene.to_dict(), described.to_dict())]  # fmt: skip
        if other:
            raise SceneError(other)
        sim.scene = described  # it may end later, or write more often
    else:
        sim = simulation_of(described, scene)
    last = sim.last_step if steps is None else steps
    reached = f"step {sim.steps_done} of {last}" + (": nothing is left to do" if sim.steps_done >= last else "")
    if auto and (sim.steps_done > last or (sim.steps_done == last and has_ended(folder, sim.ranks))):
        if IS_ROOT and not quiet:
            print(f"{folder}: {reached}")
        return
    collect_garbage()
    notes = [line for line in (note, f"continues from {reached}" if resume else "") if line]
    how: dict[str, Any] = {"quiet": quiet, "overwrite": overwrite, "steps": steps, "wall_time": limit, "setup_began": STARTED}
    Job(sim, folder, resumed=resume is not None, notes=notes, scene_file=scene, **how).run()


@app.command()
def check(scene: SceneFile) -> None:
    """Validate a scene (exit code 0 valid, 2 invalid), print its plan, and predict its run time and errors from a few steps.

    Example:   particles-mpi check my.toml
    """
    from particles_mpi.run.console import Screen
    from particles_mpi.scene.plan import plan
    from particles_mpi.study.experiment import Benchmark
    from particles_mpi.study.recommend.predict import predict

    described, screen = load(scene, quiet=False), Screen(IS_ROOT, False)
    sim = simulation_of(described, scene)
    screen.plan(described.title, plan(described, sim.rows, sim.ranks, described.steps), sim.warnings)
    found = predict(sim, Benchmark())
    if found.forecast:
        screen.say(f"  predicted: {found.forecast}")
        screen.shares(found.forecast)
    if found.costs:
        screen.say(f"  cost of each effect (what a step without it saves): {found.costs}")
    stops = any("stops within" in error for error in found.errors)
    for line in (*(f"  {error}" for error in found.errors), "valid, but the run stops: see above" if stops else "valid"):
        screen.say(line)
    if screen.console.unwritten:
        raise typer.Exit(3)


app.add_typer(study, name="study")


@app.command()
def view(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run, which may still be running.")],
    no_open: Annotated[bool, typer.Option("--no-open", help="Write the page, but do not open it.")] = False,
) -> None:
    """Write DIR/view.html, a page that shows the run and needs no network, and open it if there is a desktop.

    Example:   particles-mpi view out/marbles
    """
    import webbrowser

    from rich.filesize import decimal

    from particles_mpi.results.page import write_page
    from particles_mpi.results.run import Run

    path = Communicator().run_on_root(lambda: write_page(Run(folder)))
    if not path:
        return
    print(f"{path} ({decimal(path.stat().st_size)})")
    if not no_open and (sys.platform in ("darwin", "win32") or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys()):
        webbrowser.open(path.resolve().as_uri())


@app.command()
def doctor() -> None:
    """Show what is installed (MPI, parallel HDF5, versions), check 2 ranks, and say what to do about what is wrong."""
    from particles_mpi.run import doctor as examined

    raise typer.Exit(examined.main(IS_ROOT, MPI.COMM_WORLD.Get_size()))


def simulation_of(described: Any, scene: Path) -> Any:
    """The simulation of a scene; each fault begins with the name of its file. Collective."""
    from particles_mpi.simulation import Simulation

    try:
        return Simulation(described)
    except SceneError as error:
        raise SceneError([f"{scene}: {fault}" for fault in error.faults]) from None


def stop_after(wall_time: str | None) -> tuple[float | None, str]:
    """Seconds since STARTED after which a run stops, and a line about a limit that the user did not give. Collective."""
    from particles_mpi.run.scheduler import parse_time, slurm_limit

    if wall_time is None:
        limit, note = slurm_limit() if IS_ROOT else (None, "")
        return Communicator().bcast((None if limit is None else limit + perf_counter() - STARTED, note))
    try:
        return None if wall_time == "none" else parse_time(wall_time), ""
    except ValueError:
        raise SceneError(f"--wall-time: {wall_time!r} is not HH:MM:SS") from None


def words(arguments: list[str]) -> str:
    """The command line without the names of files: those may differ from rank to rank, what is in them may not."""
    return " ".join("FILE" if "/" in word or word.endswith((".toml", ".h5", ".json")) else word for word in arguments)


def collect_garbage() -> None:
    """From now on Python looks for cycles of objects that nobody needs, but not among those that are there already."""
    gc.freeze()
    gc.enable()


def plain_help() -> None:
    """The help has no colours and no bold letters, unless a terminal shows it to a user who has not switched colours off."""
    from particles_mpi.run.console import watched

    if os.environ.get("NO_COLOR") or not watched():
        os.environ["TTY_COMPATIBLE"] = "0"  # rich asks for this; for mpirun the output of a rank may be a terminal


def is_broken_pipe(error: BaseException) -> bool:
    """Is it that what is printed is no longer read, as behind `| head`? Not on several ranks: mpirun reads it there."""
    return isinstance(error, BrokenPipeError) or isinstance(error.__context__, BrokenPipeError)


def main() -> None:
    """Run the command. An exception on any rank ends all ranks, with one line and the exit code of the error.

    So does `sys.exit` in a user's effect: the other ranks would wait for this one.

    `__main__` has switched off the search for garbage: `run` begins it before its first step, all other commands here. When
    the process ends, everything is taken as needed: to find out what is not would take a sixth of a short run.
    """
    code: Any = 0
    if sys.argv[1:2] != ["run"]:
        collect_garbage()
    try:
        same_on_all(Communicator(), {"arguments": words(sys.argv[1:])})
        command = typer.main.get_command(app)  # not `app()`, which loses what an interruption says
        helps = "--help" in sys.argv or sys.argv[1:] in ([], ["study"])
        if helps:
            plain_help()
        aside = redirect_stdout(StringIO()) if helps and not IS_ROOT else nullcontext()
        with aside, command.make_context("particles-mpi", sys.argv[1:]) as context:
            command.invoke(context)
    except typer.Exit as error:
        code = error.exit_code
    except BaseException as error:
        if is_broken_pipe(error) and (sys.argv[1:2] != ["run"] or "--help" in sys.argv):  # all that is left to do is to print
            os._exit(0)
        wrong_arguments = getattr(error, "format_message", None)  # typer's own
        code = abort_all(SceneError(wrong_arguments()) if wrong_arguments else error)
        if isinstance(error, StoppedError) and not isinstance(error, StateError):
            sys.stdout.flush()
            os._exit(code)  # where a file could not be written, HDF5 may crash when it is closed, which the error's end would do
    sys.stdout.flush()
    gc.freeze()
    sys.exit(code)
