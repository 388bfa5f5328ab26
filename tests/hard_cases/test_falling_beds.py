"""A few hundred spheres fall, hit what lies there already, and settle: crowds of contacts, which have to end in every step."""

import numpy as np
import pytest
from with_all import with_all

from particles_mpi import Scene, Simulation

R, G = 0.05, 9.81


def falling(count, mode, e):
    """Discs at random in a box twice as high as it is wide, whose walls have a restitution of 0.8."""
    width = float(np.ceil(count**0.5) * 2.8 * R)
    return Simulation(
        Scene(
            dimension=2,
            seed=1,
            box={"lower": [0.0, 0.0], "upper": [width, 2.0 * width]},
            time={"step": 0.002, "steps": 1000},
            particles=[{"count": count, "radius": R, "mass": 1.0, "position": "random", "velocity": {"speed": 1.0}}],
            effects={
                "uniform_gravity": {"acceleration": [0.0, -G]},
                "walls": {"restitution": 0.8},
                "collisions": {"mode": mode, "restitution": e},
            },
        )
    )


@pytest.mark.parametrize(("mode", "e"), [("rewind", 0.8), *with_all(("event", 0.8), ("rewind", 0.5))])
def test_a_falling_bed_has_no_contacts_without_end(mode, e):
    """In no step there are more than a thousand contacts a disc, and the energy falls from step to step."""
    sim = falling(200, mode, e)
    sim.steps(385)
    before, hits = sim.measure()["total_energy"], sim.totals["collisions"]
    for _ in range(40):
        sim.step()
        now, new = sim.measure()["total_energy"], sim.totals["collisions"]
        assert new - hits < 1000 * len(sim.particles)
        assert now < before + len(sim.particles) * (G * 0.002) ** 2
        before, hits = now, new


@pytest.mark.parametrize("mode", ["event", *with_all("rewind")])
def test_elastic_discs_come_to_rest_on_walls_that_take_energy(mode):
    """Each hit of the floor takes its part of what the discs have, and in the end there is nothing left."""
    sim = falling(60, mode, 1.0)
    sim.steps(2500)
    assert sim.measure()["kinetic"] < 1e-12
    assert sim.totals["missed"] == 0
