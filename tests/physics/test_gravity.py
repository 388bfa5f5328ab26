"""Mutual gravity and the integrators against exact and published figures."""

import numpy as np
import pytest

from particles_mpi import Scene, SceneError, Simulation
from particles_mpi.integrators.kicks_and_drifts import COMPOSITIONS


def bodies(position, velocity, mass, step, steps, integrator="leapfrog", gravity=None, **effects):
    return Simulation(
        Scene(
            dimension=len(position[0]),
            G=1.0,
            time={"step": step, "steps": steps, "integrator": integrator},
            particles=[{"position": position, "velocity": velocity, "mass": mass}],
            effects={"mutual_gravity": gravity or {}, **effects},
        )
    )


def kepler_error(n, integrator, orbits=10, e=0.5):
    """Largest relative error of the energy of a test particle, n steps an orbit, from the pericentre."""
    sim = bodies([[1 - e, 0.0], [0.0, 0.0]], [[0.0, ((1 + e) / (1 - e)) ** 0.5], [0.0, 0.0]], [0.0, 1.0], 2 * np.pi / n,
                 n * orbits, integrator)  # fmt: skip
    p, worst = sim.particles, 0.0
    for _ in range(n * orbits):
        sim.step()
        energy = 0.5 * (p.velocity[0] ** 2).sum() - 1.0 / np.sqrt(((p.position[0] - p.position[1]) ** 2).sum())
        worst = max(worst, abs(energy / -0.5 - 1.0))
    return worst


@pytest.mark.parametrize(
    ("integrator", "order", "n", "orbits", "constant", "within"),
    [("leapfrog", 2, (200, 400), 10, 107.0, 0.01), ("order4", 4, (400, 800), 2, 4.8, 0.05)],
)
def test_order_on_an_eccentric_orbit(integrator, order, n, orbits, constant, within):
    """reference/README.md: max |dE/E| = 107/n^2 for kick-drift-kick, 4.8/n^4 for SRKN6b, e = 0.5."""
    errors = [kepler_error(k, integrator, orbits) for k in n]
    slope = -np.log(errors[1] / errors[0]) / np.log(n[1] / n[0])
    assert slope == pytest.approx(order, abs=0.05 if order == 2 else 0.1)
    assert errors[1] * n[1] ** order == pytest.approx(constant, rel=within)


# I. P. Omelyan, I. M. Mryglod, R. Folk, Comput. Phys. Commun. 146, 188 (2002): four forces a step.
XI, LAMBDA, CHI = 0.1786178958448091, -0.2123418310626054, -0.06626458266981849
PEFRL = (0.0, 0.5 - LAMBDA, LAMBDA, LAMBDA, 0.5 - LAMBDA, 0.0), (XI, CHI, 1.0 - 2.0 * (CHI + XI), CHI, XI)


def test_why_order4_is_srkn6b(monkeypatch):
    """At 2400 forces an orbit its energy is 50 times as good as that of PEFRL: 6.2e3 and 3.2e5 over the fourth power of them."""
    errors = [kepler_error(400, "order4", 2)]
    monkeypatch.setitem(COMPOSITIONS, "order4", PEFRL)
    errors.append(kepler_error(600, "order4", 2))
    assert errors[0] * 2400**4 == pytest.approx(4.8 * 6**4, rel=0.05)
    assert errors[1] * 2400**4 == pytest.approx(1.26e3 * 4**4, rel=0.05)


def test_figure_eight_returns():
    """After one period, 4000 steps (C. Moore 1993; figures of Chenciner and Montgomery 2000)."""
    sim = Simulation(Scene.load("particles_mpi/scenes/figure_eight.toml"))
    x, energy = sim.particles.position.copy(), sim.measure()["total_energy"]
    sim.run()
    np.testing.assert_allclose(sim.particles.position, x, atol=1e-9)
    assert energy == pytest.approx(-1.2871419956318577, abs=1e-13)
    assert sim.measure()["total_energy"] == pytest.approx(energy, abs=1e-12)


def test_pythagorean_problem():
    """reference/README.md: m = 3 at t = 10 and 20, after encounters of 0.0004."""
    sim = Simulation(Scene.load("particles_mpi/scenes/pythagorean.toml"))
    for steps, place in ((100, (0.778480410138, 0.141392300290)), (200, (3.004292636696, 0.511925235025))):
        while sim.steps_done < steps:
            sim.step()
        np.testing.assert_allclose(sim.particles.position[0], place, atol=1e-6)


@pytest.mark.parametrize("d", [1, 2, 3, 4])
@pytest.mark.parametrize("softening", [0.0, 0.3])
def test_direct_sum(d, softening):
    """Against the formula, with test particles, fixed ones and two at one place."""
    random = np.random.default_rng(d)
    x, m = random.standard_normal((150, d)), random.random(150)
    m[::7] = 0.0
    x[10] = x[11]
    sim = bodies(x.tolist(), [0.0] * d, m.tolist(), 0.1, 1, gravity={"softening": softening})
    r = x[None] - x[:, None]
    r2 = (r**2).sum(axis=2) + softening**2
    with np.errstate(divide="ignore", invalid="ignore"):
        pull = np.nan_to_num(m[None, :, None] * r / r2[..., None] ** 1.5, nan=0.0)
    np.testing.assert_allclose(sim.sum_forces(), pull.sum(axis=1), rtol=1e-12, atol=1e-12 * np.abs(pull).max())


def test_force_is_the_slope_of_the_potential():
    """Work along a small path is the loss of potential energy, whether the partner moves or is fixed."""
    for fixed in (False, True):
        at = {}
        for shift in (-1e-5, 1e-5):
            tables = [{"position": [[1.0 + shift, 0.3]], "mass": 2.0}, {"position": [[0.0, 0.0]], "mass": 3.0, "fixed": fixed}]
            effects = {"mutual_gravity": {"softening": 0.2}}
            sim = Simulation(Scene(dimension=2, G=1.5, time={"step": 1.0, "steps": 1}, particles=tables, effects=effects))
            at[shift] = sim.measure()["potential"]
        force = 2.0 * sim.sum_forces()[0, 0]
        assert -(at[1e-5] - at[-1e-5]) / 2e-5 == pytest.approx(force, rel=1e-4)


def test_what_is_conserved():
    """A cold cluster of 100: momentum and angular momentum to round-off, energy as dt^2, the centre where it was."""
    random = np.random.default_rng(1)
    x = random.standard_normal((100, 3))
    errors = []
    for steps in (100, 200):
        sim = bodies(x.tolist(), [0.0] * 3, 0.01, 2.0 / steps, steps, gravity={"softening": 0.1})
        before = sim.measure()
        sim.run()
        after = sim.measure()
        for name in ("momentum_x", "angular_momentum_x", "angular_momentum_z", "center_y"):
            assert after[name] == pytest.approx(before[name], abs=1e-13)
        errors.append(abs(after["total_energy"] / before["total_energy"] - 1.0))
    assert errors[1] < 1e-4 and errors[1] == pytest.approx(errors[0] / 4.0, rel=0.2)


def test_one_force_a_step():
    sim = bodies([[1.0, 0.0], [0.0, 0.0]], [0.0, 0.0], 1.0, 0.01, 10)
    sim.run()
    assert sim.calls["mutual_gravity"] == 11
    sim.particles.position[0, 0] += 0.1  # a user's move is noticed
    sim.step()
    assert sim.calls["mutual_gravity"] == 13


@pytest.mark.parametrize("integrator", ["order4", "adaptive"])
@pytest.mark.parametrize("effect", ["collisions", "drag", "friction"])
def test_integrators_refuse_what_they_cannot_do(integrator, effect):
    keys = {"drag": {"rate": 1.0}, "friction": {"strength": 1.0}}.get(effect, {})
    with pytest.raises(SceneError, match=f'time.integrator: "{integrator}" .* which {effect} does not allow; use "leapfrog"'):
        bodies([[0.0, 0.0]], [0.0, 0.0], 1.0, 0.1, 1, integrator, None, **{effect: keys})


def test_masses_that_meet_head_on_stop_the_adaptive_integrator():
    sim = bodies([[1.0, 0.0], [-1.0, 0.0]], [0.0, 0.0], 1.0, 5.0, 1, "adaptive")
    with pytest.raises(Exception, match="steps get shorter than"):
        sim.run()
