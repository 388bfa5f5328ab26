"""The commands `particles-mpi study ...`: their arguments and help texts."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.run.scene_file import SceneFile, given_path, load

AnyScene = Annotated[Path | None, typer.Argument(metavar="[SCENE.toml]", help="Your scene (default: the built-in problems).")]
Folder = Annotated[
    Path | None, typer.Option(parser=given_path, metavar="DIR", help="Folder for the report, pictures and CSV files.")
]
Quick = Annotated[bool, typer.Option("--quick", help="A first look within a minute: fewer settings, shorter samples.")]
TUNED = "File for the tuned scene (default: NAME.tuned.toml)."
TunedFile = Annotated[Path | None, typer.Option(parser=given_path, metavar="TUNED.toml", help=TUNED)]


class Studies(TyperGroup):
    """`study SCENE.toml` is `study accuracy SCENE.toml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, ["accuracy", *args] if args and args[0].endswith(".toml") else args)


study = typer.Typer(
    cls=Studies,
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="""Measure the program on this machine: what accuracy costs, what a scene needs, how it scales, and what must hold.

    [bold]study SCENE.toml[/bold] is short for [bold]study accuracy SCENE.toml[/bold].""",
)


@study.command("accuracy")
def accuracy(
    scene: AnyScene = None,
    only: Annotated[str, typer.Option(metavar="LETTERS", help="Only these built-in experiments, such as AC.")] = "",
    quick: Quick = False,
    output: Folder = None,
) -> None:
    """Measure what accuracy costs: error against seconds and work, for a scene or for the built-in problems.

    A scene takes about two minutes.

    A orbits, B close encounters, C hard-sphere fluid, D tree, F softening, G drag and friction, H effects on and off,
    I lasting contacts, J rough spheres.

    Example:   ./run.sh study accuracy --quick
    """
    from particles_mpi.study.accuracy.command import study_accuracy

    described = load(scene) if scene else None
    if described and only:
        raise SceneError("--only: chooses among the built-in experiments; leave it out with a scene")
    study_accuracy(described, only, quick, output or Path("out/study") / (scene.stem if scene else "accuracy"))


@study.command("recommend")
def recommend(
    scene: SceneFile,
    tolerance: Annotated[float, typer.Option(help="Relative error that is allowed.")],
    error: Annotated[
        str,
        typer.Option(metavar="NAME", help="The only error that counts: state, energy, ... (default: all that can be measured)."),
    ] = "",
    output: TunedFile = None,
    seconds: Annotated[float, typer.Option(min=1.0, help="About how many seconds to measure.")] = 60.0,
) -> None:
    """Find the cheapest setting of a scene that reaches a tolerance, verify it at half the step, and write it as a scene.

    Example:   ./run.sh study recommend my.toml --tolerance 1e-6
    """
    from particles_mpi.study.recommend.recommend import recommend_scene

    recommend_scene(scene, tolerance, error, output, seconds)


@study.command("scaling")
def scaling(
    scene: Annotated[Path | None, typer.Argument(metavar="[SCENE.toml]", help="Your scene (default: headline.toml).")] = None,
    quick: Quick = False,
    output: Folder = None,
    counts: Annotated[
        bool, typer.Option("--counts", help="Count only what ranks send and hold; there may be more ranks than cores.")
    ] = False,
) -> None:
    """Measure strong and weak scaling over 1, 2, 4 ... of the ranks started, with phases and a model for more ranks.

    Example:   RANKS=4 ./run.sh study scaling my.toml,   RANKS=32 ./run.sh study scaling --counts
    """
    from particles_mpi.study.scaling.counted import count_scaling
    from particles_mpi.study.scaling.measure import measure_scaling

    described, folder = load(scene) if scene else None, output or Path("out/study/scaling") / (scene.stem if scene else "")
    (count_scaling if counts else measure_scaling)(described, folder, quick)


@study.command("hard-cases")
def hard_cases(
    only: Annotated[
        str | None, typer.Option(metavar="TEXT", help="Only cases with this text in their name, long ones included.")
    ] = None,
    full: Annotated[
        bool, typer.Option("--full", help="Include the cases that take many minutes: beds of 10 000 for 10 s.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option(parser=given_path, metavar="FILE.json", help="File for the outcomes, as JSON.")
    ] = None,
) -> None:
    """Run cases that naive programs get wrong, and check what must hold; exit code 3 if something does not.

    Example:   ./run.sh study hard-cases --only column
    """
    from particles_mpi.study.hard_cases.catalogue import study_hard_cases

    if not study_hard_cases(only, full, output):
        raise StoppedError("hard cases: something that must hold does not, see FAIL above")
