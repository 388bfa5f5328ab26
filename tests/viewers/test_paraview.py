"""The script beside a run that shows it in ParaView: with the real ParaView where there is one, on a screen that nobody sees."""

import os
import shutil
import subprocess

import numpy as np
import pytest
from matplotlib import image
from scipy import ndimage

from particles_mpi import Scene, Simulation
from particles_mpi.output import vtk

ELSEWHERE = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV", "GLIBC_TUNABLES")}


def ran(folder, **scene):
    Simulation(Scene(**{"dimension": 3, "time": {"step": 0.1, "steps": 4}, "output": {"every": 2}} | scene)).run(folder)
    return folder


def pvbatch(folder):
    """The picture that ParaView makes of a run, and what it says."""
    if not (shutil.which("pvbatch") and shutil.which("xvfb-run")):
        pytest.skip("no ParaView: pvbatch and xvfb-run are not installed")
    folder = folder.rename(folder.with_name("moved"))  # the script goes with its run
    screen = "-screen 0 1280x1024x24 -noreset"  # one that resets itself refuses the connection that comes meanwhile
    words = "xvfb-run", "-a", "-s", screen, "pvbatch", "--force-offscreen-rendering"
    command = [*words, folder / "view_paraview.py", folder / "picture.png"]
    done = subprocess.run(
        list(map(str, command)), env=ELSEWHERE | {"PATH": "/usr/bin:/bin"}, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    return image.imread(folder / "picture.png")[..., :3]


def balls(picture):
    """Pixels of coloured spheres, without bar, axes and lines: the middle of the picture."""
    high, wide = picture.shape[:2]
    return (np.ptp(picture, axis=2) > 0.1)[int(0.1 * high) : int(0.8 * high), int(0.15 * wide) : int(0.85 * wide)]


def test_the_script_is_there_from_the_beginning_and_knows_its_scene(tmp_path):
    walls = {"planes": [{"point": [0, 0, 0.5], "normal": [0, 0.3, 1]}]}
    scene = {"box": {"lower": [0, 0, 0], "upper": [2, 2, 2]}, "particles": [{"position": [[1, 1, 1]], "radius": 0.1}]}
    folder = ran(tmp_path / "run", **scene, effects={"walls": walls})
    text = (folder / "view_paraview.py").read_text()
    compile(text, "view_paraview.py", "exec")
    line = next(line for line in text.splitlines() if line.startswith("RUN"))
    told = eval(line.partition("=")[2])
    assert told["box"] == [[0, 0, 0], [2, 2, 2]] and not told["planar"] and told["folder"] == str(folder)
    assert sorted(told["walls"][0]) == [[0, 0, 0.5], [0, 5 / 3, 0], [2, 0, 0.5], [2, 5 / 3, 0]]
    silent = ran(tmp_path / "silent", **scene | {"output": {"formats": []}})
    assert not (silent / "view_paraview.py").exists()


def test_spheres_of_true_radii_in_space(tmp_path):
    """The picture's share of one large sphere, known from its perspective."""
    scene = {"box": {"lower": [-1, -1, -1], "upper": [1, 1, 1]}, "particles": [{"position": [[0, 0, 0]], "radius": 0.8}]}
    shown = balls(pvbatch(ran(tmp_path / "run", **scene)))
    distance = 2.15 * np.sqrt(12)
    radius = 0.8 / np.sqrt((distance * np.hypot(np.hypot(0.47, 0.81), 0.34)) ** 2 - 0.8**2) / (2 * np.tan(np.radians(15)))
    assert shown.sum() == pytest.approx(np.pi * (radius * 900) ** 2, rel=0.05)


def test_a_planar_run_and_points_in_open_space(tmp_path):
    scene = {"dimension": 2, "box": {"lower": [0, 0], "upper": [4, 3]}, "particles": [{"position": [[2, 1.5]], "radius": 0.5}]}
    shown = balls(pvbatch(ran(tmp_path / "flat" / "run", **scene)))
    assert shown.sum() == pytest.approx(np.pi * (0.5 / (2 * 0.55 * 3) * 900) ** 2, rel=0.05)
    points = {"particles": [{"position": [[0, 0, 0], [1, 1, 1]], "velocity": [1, 0, 0]}]}
    assert balls(pvbatch(ran(tmp_path / "open" / "run", **points))).sum() > 50


def test_frames_in_pieces_are_shown_whole(tmp_path, monkeypatch):
    """Half of a row of spheres is in each piece: all of them are seen, at the last of the times."""
    monkeypatch.setattr(vtk, "PIECE_IDS", 4)
    row = [{"position": [[x, 0, 0] for x in range(8)], "radius": 0.4, "velocity": [0, 0, 1]}]
    folder = ran(
        tmp_path / "run", box={"lower": [-1, -2, -2], "upper": [8, 2, 2]}, particles=row, output={"every": 2, "formats": ["vtk"]}
    )
    assert len(list((folder / "vtk").glob("*.pvtu"))) == 3
    assert ndimage.label(balls(pvbatch(folder)))[1] == 8
