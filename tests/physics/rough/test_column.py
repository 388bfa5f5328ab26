"""A column of rough discs that falls over: against soft discs, another program, and in how many contacts."""

from pathlib import Path

import numpy as np
import pytest
from soft_discs import FRICTION, GRAVITY, MASS, MOMENTS, RADIUS, RESTITUTION, column
from with_all import with_all

from particles_mpi import Scene, Simulation

SOFT = np.genfromtxt(Path(__file__).parent / "reference" / "column.csv", delimiter=",", names=True, skip_header=1)
STEP = 0.002


def simulation(**effects):
    """The column of `soft_discs`."""
    surface = {"restitution": RESTITUTION, "friction": FRICTION}
    common = {"uniform_gravity": {"acceleration": [0.0, -GRAVITY]}, "walls": surface, "collisions": surface}
    return Simulation(
        Scene(
            dimension=2,
            box={"lower": [0.0, 0.0], "upper": [6.0, 3.0]},
            time={"step": STEP, "steps": 300},
            particles=[{"position": column(), "radius": RADIUS, "mass": MASS}],
            effects=common | effects,
        )
    )


def fall(sim, moments):
    """(mean height, largest x) at so many of the MOMENTS."""
    seen = []
    for _ in range(moments):
        sim.steps(round(MOMENTS[0] / STEP))
        seen.append((sim.particles.position[:, 1].mean(), sim.particles.position[:, 0].max()))
    return np.array(seen).T


@pytest.mark.parametrize("moments", [5, *with_all(10)])
def test_falls_as_soft_discs_do(moments):
    """Heights within a radius, of 0.5 in all, and the front within three; springs of two stiffnesses differ by 0.3 and by 2.5."""
    height, front = fall(simulation(), moments)
    assert np.abs(height - 0.5 * (SOFT["height"] + SOFT["height_stiff"])[:moments]).max() < RADIUS
    assert np.abs(front - 0.5 * (SOFT["front"] + SOFT["front_stiff"])[:moments]).max() < 3.0 * RADIUS


def test_falls_in_few_contacts():
    """With resistance to rolling. What solutions left was hit after hit: 1.8 million in these steps, 679 times without room."""
    sim = simulation(rolling={"resistance": 0.1 * RADIUS})
    height, _ = fall(sim, 5)
    assert sim.totals["collisions"] < 30_000 and sim.totals["missed"] == sim.totals["unconverged"] == 0
    assert np.allclose(height, [0.8245, 0.7898, 0.7645, 0.7515, 0.7304], rtol=0.0, atol=0.6 * RADIUS)  # of steps of 0.0005
