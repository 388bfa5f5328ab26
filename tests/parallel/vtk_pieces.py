"""A run whose VTK frames are cut into blocks of PIECE_IDS ids: vtk_pieces.py FOLDER PIECE change|run|kill|full.

change: particles are added and removed, so that frames have one block, many, and blocks without particles. run: 40 particles,
frames at steps 0, 5 and 10; goes on from the checkpoint in the folder if there is one. kill: the same, but rank 0 is killed at
step 5 between the pieces and the file that names them. full: rank 1 cannot write its piece of step 5, as on a full disk.
"""

import os
import signal
import sys
from pathlib import Path

from particles_mpi import Scene, Simulation, StoppedError
from particles_mpi.output import vtk

folder, piece, what = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
tables = {
    "dimension": 2,
    "seed": 1,
    "box": {"lower": [0, 0], "upper": [10, 10]},
    "time": {"step": 0.01, "steps": 10},
    "particles": [{"count": 40, "position": "random", "radius": 0.1, "velocity": {"speed": 1.0}}],
    "effects": {"collisions": {}, "walls": {}},
    "output": {"every": 5, "checkpoint_every": 2, "diagnostics_every": 5},
}
whole = vtk.PIECE_IDS, vtk.Blocks.write, vtk._write_pvtu


def come_and_go() -> None:
    """Frames of 12, 12, 52, 36, 6 and no particles; the ids of the last but one begin at 32."""
    tables["particles"][0]["count"] = 12
    tables["time"]["steps"] = 30
    sim = Simulation(Scene(**tables))
    sim.run(folder, steps=6)
    sim.add({"count": 40, "position": "random", "radius": 0.1})
    for step, removed in ((11, range(16, 32)), (16, [*range(16), *range(38, 52)]), (21, range(32, 38)), (26, [])):
        sim.run(folder, steps=step, resumed=True)
        sim.remove(removed)


def killed(path: Path, *_: object) -> None:
    """In place of `vtk._write_pvtu`."""
    if "000005" in path.name:
        os.kill(os.getpid(), signal.SIGKILL)
    whole[2](path, *_)


def full(blocks: vtk.Blocks, path: Path, columns: dict) -> None:
    """In place of `vtk.Blocks.write`."""
    whole[1](blocks, path, columns)
    if "000005" in path.parent.name and "000001" in path.name:
        raise OSError(28, "No space left on device")


vtk.PIECE_IDS = piece
try:
    if what == "change":
        come_and_go()
    else:
        vtk._write_pvtu = killed if what == "kill" else whole[2]
        vtk.Blocks.write = full if what == "full" else whole[1]
        resumed = (folder / "checkpoint.h5").exists()
        sim = Simulation.resume(folder / "checkpoint.h5") if resumed else Simulation(Scene(**tables))
        sim.run(folder, resumed=resumed)
except StoppedError as error:
    print(error)
finally:
    vtk.PIECE_IDS, vtk.Blocks.write, vtk._write_pvtu = whole
