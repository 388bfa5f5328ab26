"""The script that shows a run in ParaView: `view_paraview.py`, with the box and the walls of a scene filled in."""

from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi.results.scenery import scenery

EMPTY = "RUN: dict = {}"


def paraview_script(folder: Path, scene: dict[str, Any]) -> str:
    """The text of the script for the run of a scene (as tables) in this folder."""
    around = scenery(scene, np.zeros(3), np.zeros(3))
    facts = {
        "folder": str(folder.resolve()),
        "box": [around.lower.tolist(), around.upper.tolist()] if around.real else None,
        "walls": [corners.tolist() for corners, _ in around.walls] if around.real else [],
        "planar": scene["dimension"] < 3,
    }
    text = (Path(__file__).parent / "view_paraview.py").read_text(encoding="utf-8")
    return text.replace(EMPTY, f"RUN = {facts!r}")
