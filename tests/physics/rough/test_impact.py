"""Oblique impacts of rough spheres on one another and on a wall, against the measured law of three parameters."""

import numpy as np
import pytest
from impact import SOLID, Surface, band, measured, slides_from, slip_after

from particles_mpi import Scene, Simulation

PSI = np.concatenate((np.linspace(0.0, 1.2, 13), [1.5, 2.0, 3.0, 5.0, 8.0]))
FALL = 0.7  # |u_n|


def test_limits_of_the_law():
    """Smooth keeps the slip, no limit reverses beta_0 of it, and both lines meet."""
    assert slip_after(PSI, Surface(0.9, 0.3, -1.0), 0.4) == pytest.approx(PSI)
    assert slip_after(PSI, Surface(0.9, 0.0, 0.5), 0.4) == pytest.approx(PSI)
    assert slip_after(PSI, Surface(0.9, 1e9, 0.5), 0.4) == pytest.approx(-0.5 * PSI)
    glass, _ = measured()["soda lime glass"]
    edge = np.array([slides_from(glass, 0.4)])
    assert slip_after(edge, glass, 0.4) == pytest.approx(-glass.tangential * edge)
    assert edge[0] == pytest.approx(0.4405, abs=1e-4)  # 3.5 mu (1 + e)/(1 + beta_0)


@pytest.mark.parametrize("material", measured())
def test_band_holds_any_parameters_within_their_scatter(material):
    surface, scatter = measured()[material]
    low, high = band(PSI, surface, scatter, 0.4)
    random = np.random.default_rng(1)
    for part in random.uniform(-1.0, 1.0, (200, 3)):
        psi = slip_after(PSI, Surface(*(s + p * d for s, p, d in zip(surface, part, scatter, strict=True))), 0.4)
        assert (psi >= low - 1e-15).all() and (psi <= high + 1e-15).all()


def rebound(psi, surface, dimension, mode, target, spinning):
    """psi_2 of a simulated impact, and what it leaves across the plane of impact.

    A sphere falls along the last axis on a free one like it, or on a wall. Its surface slips along the first axis by psi |u_n|:
    by its spin for the part `spinning` of that, by its velocity for the rest.
    """
    radius, slip, step = 0.3, psi * FALL, 0.05
    velocity, spin = np.zeros(dimension), np.zeros(dimension * (dimension - 1) // 2)
    velocity[0], velocity[-1] = (1.0 - spinning) * slip, -FALL
    # The point of contact is at -R k, where the spin adds spin x (-R k): along the first axis -R spin_y in space, R spin in
    # the plane.
    spin[1 if dimension == 3 else 0] = spinning * slip / radius * (-1.0 if dimension == 3 else 1.0)
    above = np.zeros(dimension)
    above[0], above[-1] = -velocity[0] * step / 2.0, (2.0 if target == "pair" else 1.0) * radius + FALL * step / 2.0
    bodies = [{"position": [above.tolist()], "velocity": velocity.tolist(), "spin": spin.tolist(), "radius": radius, "mass": 1.3}]
    law = {"restitution": surface.restitution, "friction": surface.friction, "tangential_restitution": surface.tangential}
    effects = {"collisions": {"mode": mode, **law}}
    if target == "pair":
        bodies.append({"position": [[0.0] * dimension], "velocity": [0.0] * dimension, "radius": radius, "mass": 1.3})
    else:
        up = [0.0] * (dimension - 1) + [1.0]
        effects["walls"] = {**law, "planes": [{"point": [0.0] * dimension, "normal": up}]}
    sim = Simulation(
        Scene.from_dict({"dimension": dimension, "time": {"step": step, "steps": 1}, "particles": bodies, "effects": effects})
    )
    sim.run()
    rows = np.argsort(sim.particles.id)
    v, s = sim.particles.velocity[rows], sim.particles.spin[rows]
    after, turned = (v[0] - v[1], s[0] + s[1]) if target == "pair" else (v[0], s[0])
    assert after[-1] == pytest.approx(surface.restitution * FALL, abs=1e-12)
    rim = np.cross(turned, [0.0, 0.0, -radius]) if dimension == 3 else np.array([radius * turned[0], 0.0])
    return (after + rim)[0] / FALL, np.abs((after + rim)[1:-1]).sum()


@pytest.mark.parametrize("mode", ["rewind", "event"])
@pytest.mark.parametrize("target", ["pair", "wall"])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("material", measured())
def test_impacts(material, dimension, target, mode):
    """On the two lines, within the band of what was measured, whatever makes the surfaces slip."""
    surface, scatter = measured()[material]
    inertia = SOLID[dimension]
    psi_1 = PSI[::3]
    expected = slip_after(psi_1, surface, inertia)
    low, high = band(psi_1, surface, scatter, inertia)
    for spinning in (0.0, 0.4, 1.0):
        found = np.array([rebound(psi, surface, dimension, mode, target, spinning) for psi in psi_1])
        np.testing.assert_allclose(found[:, 0], expected, atol=1e-12)
        assert (found[:, 0] >= low - 1e-12).all() and (found[:, 0] <= high + 1e-12).all()
        assert (found[:, 1] < 1e-12).all()
