"""The scenes of rough spheres: the cue ball that backspin pulls back, and the heap below an hourglass."""

import shutil

import numpy as np
import pytest
from conftest import ROOT, run_ranks
from with_all import with_all

from particles_mpi import Run, Scene, Simulation

pytestmark = pytest.mark.parallel
SCENES = ROOT / "particles_mpi" / "scenes"


def shot(spin, end, smooth=False):
    """The break shot with this spin of the cue ball, up to a time; with `smooth` balls that touch a smooth table."""
    tables = Scene.load(SCENES / "break_shot.toml").to_dict()
    tables["time"]["end"] = end
    tables["particles"][0]["spin"] = spin
    if smooth:
        del tables["effects"]["rolling"], tables["particles"][0]["spin"]
        for table in (tables["effects"]["collisions"], *tables["effects"]["walls"]["planes"]):
            del table["friction"]
    sim = Simulation(Scene.from_dict(tables))
    sim.run()
    cue = sim.particles.id == 0
    return sim, sim.particles.velocity[cue][0, 0]


def test_backspin_pulls_the_cue_ball_back_and_topspin_drives_it_on():
    """Between 0.3 and 0.8 the spin alone changes its velocity; a smooth ball keeps what the rack gave it."""
    draw, follow = [0.0, -150.0, 60.0], [0.0, 180.0, 0.0]
    assert shot(draw, 0.8)[1] < shot(draw, 0.3)[1] - 0.3 and shot(draw, 0.8)[1] < -0.39
    assert shot(follow, 0.8)[1] > shot(follow, 0.3)[1] + 0.5 and shot(follow, 0.8)[1] > 0.2
    assert shot(draw, 0.8, smooth=True)[1] == shot(draw, 0.3, smooth=True)[1]


def test_all_balls_come_to_rest_exactly():
    sim, _ = shot([0.0, -150.0, 60.0], 10.0)
    assert not sim.particles.velocity.any() and not sim.particles.spin.any()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With both scenes, shortened, and half of the grains."""
    folder = tmp_path_factory.mktemp("rough")
    for name, end, changed in (("break_shot", "end = 10.0", "end = 0.6"), ("hourglass", "end = 2.5", "end = 0.3")):
        text = (SCENES / f"{name}.toml").read_text()
        assert end in text
        (folder / f"{name}.toml").write_text(text.replace(end, changed))
    (folder / "hourglass.csv").write_text("\n".join((SCENES / "hourglass.csv").read_text().splitlines()[:301]) + "\n")
    return folder


@pytest.mark.parametrize("name", ["break_shot", *with_all("hourglass")])
def test_the_same_bits_on_one_rank_and_on_two(folder, name):
    for ranks in (1, 2):
        words = "run", folder / f"{name}.toml", "--output", folder / f"{name}{ranks}", "--quiet"
        done = run_ranks(ranks, "-m", "particles_mpi", *words, timeout=300)
        assert done.returncode == 0, done.stderr
    one, two = Run(folder / f"{name}1"), Run(folder / f"{name}2")
    assert len(one) == len(two) > 3 and "spin" in one[-1].fields and one[-1].spin.shape[1] == 3
    for a, b in zip(one, two, strict=True):
        assert all(a[field].tobytes() == b[field].tobytes() for field in a.fields)


def heap_slope(frame, below=0.25, cell=0.02):
    """Degrees: mean slope of both sides of what lies below the opening, by least squares through the tops of cells along x."""
    grains = (frame.fixed == 0) & (frame.position[:, 2] < below)
    x, top = np.abs(frame.position[grains, 0]), frame.position[grains, 2] + frame.radius[grains]
    edges = np.arange(0.0, 0.45, cell)
    heights = np.array([top[(x >= left) & (x < left + cell)].max(initial=0.0) for left in edges])
    chosen = (heights > 0.2 * heights.max()) & (edges > 0.02)
    return float(np.degrees(np.arctan(-np.polyfit(edges[chosen] + 0.5 * cell, heights[chosen], 1)[0])))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_hourglass_leaves_a_heap_and_grains_on_the_funnel(tmp_path):
    for suffix in ("toml", "csv"):
        shutil.copy(SCENES / f"hourglass.{suffix}", tmp_path)
    done = run_ranks(
        2, "-m", "particles_mpi", "run", tmp_path / "hourglass.toml", "--output", tmp_path / "o", "--quiet", timeout=800
    )
    assert done.returncode == 0, done.stderr
    run = Run(tmp_path / "o")
    last = run[-1]
    grains = last.fixed == 0
    assert 15.0 < heap_slope(last) < 40.0
    assert 0.02 < (last.position[grains, 2] > 0.25).mean() < 0.5
    assert run.columns["kinetic"][-1] < 0.01 * run.columns["kinetic"].max()
