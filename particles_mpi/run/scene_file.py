"""Reads the scene file of a command and compares it among the ranks; also checks other paths in its options."""

from pathlib import Path
from typing import Annotated, Any

import typer

from particles_mpi.parallel.agreement import raising_together, same_on_all
from particles_mpi.parallel.communicator import Communicator

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE.toml", help="The scene: see particles_mpi/scenes/ for examples.")]


def given_path(text: str) -> Path:
    """Return the path in an option. An empty text, as of a shell variable that is not set, is not taken for this folder."""
    if not text:
        raise typer.BadParameter("is empty")
    return Path(text)


def load(path: Path, quiet: bool = True) -> Any:
    """Load the scene of a file: the same on all ranks, or refused. Unless `quiet`, tell the user of compiling. Collective."""
    from particles_mpi.run.console import announce_compiling
    from particles_mpi.scene.schema import Scene

    ranks = Communicator()
    with raising_together(ranks):
        described = Scene.load(path)
    same_on_all(ranks, described.to_dict())
    if ranks.is_root and not quiet:
        announce_compiling(described)
    return described
