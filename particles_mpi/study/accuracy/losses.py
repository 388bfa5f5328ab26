"""G: drag and friction. Compares leapfrog, which advances them exactly, with PBPhys's explicit rule, also at long steps; and
measures the order of bounces under every force, on every obstacle, with every loss.
"""

from itertools import product
from math import exp
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from particles_mpi import Simulation
from particles_mpi.particles import Array
from particles_mpi.study.accuracy.bouncing import DURATION as BOUNCING_TIME
from particles_mpi.study.accuracy.bouncing import FORCES, LOSSES, OBSTACLES, bounces, mean_errors, scene
from particles_mpi.study.experiment import ENDLESS_STEPS, Benchmark, Errors, Experiment, Setting, all_particles, slope

G, DRAG, DURATION, THROW = 9.81, 0.5, 2.0, (10.0, 10.0)
STEPS, QUICK_STEPS = (2, 4, 16, 64, 256), (8, 16, 32, 64)
REPEATS = 200  # particles alike, so that a run is no mere overhead
STIFF_DRAG = 20.0 / DURATION  # rate of the stiff drag
BOUNCE_STEPS = (0.01, 0.005, 0.0025, 0.00125)  # steps
ERRORS = {"place": f"distance from the true position at t = {DURATION:g}", "velocity": "the same of the velocity"}


def thrown(drag: float, t: float = DURATION) -> tuple[Array, Array]:
    """Return position and velocity under gravity and linear drag: dv/dt = g - k v."""
    g, v0 = np.array([0.0, -G]), np.array(THROW)
    decay = exp(-drag * t)
    return g / drag * t + (v0 - g / drag) * (1.0 - decay) / drag, g / drag + (v0 - g / drag) * decay


def sliding(t: float = DURATION) -> tuple[Array, Array]:
    """Return the same for a sideways throw under friction alpha = m g, by a Runge-Kutta method of order 8 at 1e-13."""

    def rate(_: float, state: Array) -> Array:
        v = state[2:]
        return np.array([*v, *(np.array([0.0, -G]) - G * v / np.sqrt((v**2).sum()))])

    end = solve_ivp(rate, (0.0, t), [0.0, 0.0, THROW[0], 0.0], "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    return end[:2], end[2:]


def throw(
    benchmark: Benchmark, key: str, title: str, velocity: tuple[float, float], loss: dict[str, Any], true: tuple[Array, Array],
    reference: str = "exact: x(t) of linear drag", integrators: tuple[str, ...] = ("leapfrog", "taylor"),
) -> Experiment:  # fmt: skip
    """Throw particles in a plane under gravity and a loss, with each integrator over a range of steps; find the orders."""

    def errors(sim: Simulation) -> Errors:
        sim.run()
        p = all_particles(sim)
        wrong = zip(ERRORS, (p.position[0] - true[0], p.velocity[0] - true[1]), strict=True)
        return {name: float(np.abs(off).max()) for name, off in wrong}

    tried = []
    for integrator, n in product(integrators, QUICK_STEPS if benchmark.quick else STEPS):
        time = {"step": DURATION / n, "steps": n, "integrator": integrator}
        particles = [{"position": [[0.0, 0.0]] * REPEATS, "velocity": list(velocity), "mass": 1.0}]
        effects = {"uniform_gravity": {"acceleration": [0.0, -G]}, **loss}
        tables = {"dimension": 2, "time": time, "particles": particles, "effects": effects}
        tried.append(benchmark.setting(integrator, DURATION / n, tables, errors, steps=ENDLESS_STEPS, seconds_of=n))
    found = benchmark.compare(key, title, tried, ERRORS, reference, slopes=(1.0, 2.0), floor=1e-12)
    for curve in found.curves:
        fine = [row for row in found.curve(curve) if row.errors["place"] > 1e-9][-3:]
        found.answers.append(f"{curve}: order {slope(fine, 'place'):.2f} in place")
    return found


def throws(benchmark: Benchmark) -> list[Experiment]:
    """Measure G1 to G3: with drag that acts over many steps, drag that acts within one (k h = 10 in the longest), and friction.

    Friction is as strong as the weight: a particle thrown sideways falls at half its speed in the end.
    """
    stiff_title, order_8 = f"Stiff drag, k = {STIFF_DRAG:g}", "Runge-Kutta of order 8 (DOP853) at 1e-13"
    weak = throw(benchmark, "G1", "Throw with drag", THROW, {"drag": {"rate": DRAG}}, thrown(DRAG))
    stiff = throw(benchmark, "G2", stiff_title, THROW, {"drag": {"rate": STIFF_DRAG}}, thrown(STIFF_DRAG))
    sideways, friction = (THROW[0], 0.0), {"friction": {"strength": G}}
    rubbed = throw(benchmark, "G3", "Throw with friction", sideways, friction, sliding(), order_8, ("leapfrog",))
    most = max(row.errors["velocity"] for row in weak.curve("leapfrog"))
    weak.answers.append(f"leapfrog has the right velocity with any step: error <= {most:.0e}")
    exact, explicit = (stiff.curve(name)[0] for name in ("leapfrog", "taylor"))
    stiff.answers.append(
        f"at k h = {STIFF_DRAG * explicit.setting.parameter:.3g} taylor is wrong by {explicit.errors['velocity']:.1g} in "
        f"velocity, leapfrog by {exact.errors['velocity']:.0e}"
    )
    return [weak, stiff, rubbed]


def bounce(benchmark: Benchmark, force: str, loss: str, resistances: tuple[str, ...], h: float) -> Setting:
    """Return the setting of balls that bounce for a second on all obstacles."""
    cases = tuple(product(OBSTACLES, resistances))
    tables, shift = scene(force, "rewind", h, bounces(2, force, loss, cases, h))

    def errors(sim: Simulation) -> Errors:
        sim.run()
        end = bounces(2, force, loss, cases, h)
        end.advance(np.full(len(shift), BOUNCING_TIME))
        wrong = mean_errors(sim, shift, end).reshape(len(OBSTACLES), -1).max(axis=1)
        return dict(zip(OBSTACLES, wrong.tolist(), strict=True))

    curve = f"{force}, {loss}, {'friction' if 'friction' in resistances else 'without and with drag'}"
    return benchmark.setting(curve, h, tables, errors, steps=ENDLESS_STEPS, seconds_of=round(BOUNCING_TIME / h))


def bouncing(benchmark: Benchmark) -> list[Experiment]:
    """Measure G4: contacts at any moment of a step. Collective."""
    steps, forces = (BOUNCE_STEPS[:2], FORCES[:3]) if benchmark.quick else (BOUNCE_STEPS, FORCES)
    tried = [bounce(benchmark, *with_) for with_ in product(forces, LOSSES, (("none", "drag"), ("friction",)), steps)]
    errors = {
        name: f"distance from the true position after a second, mean over the phases of a step: {name}" for name in OBSTACLES
    }
    reference = "Runge-Kutta of order 4 from contact to contact"
    found = benchmark.compare("G4", "Bounces", tried, errors, reference, slopes=(2.0,), floor=1e-9)
    orders = [slope(found.curve(curve), name) for curve in found.curves for name in OBSTACLES]
    most = max(max(found.curve(curve)[0].errors.values()) for curve in found.curves)
    found.answers.append(f"order {min(orders):.2f} to {max(orders):.2f}; error at a step of {steps[0]:g} at most {most:.1e}")
    return [found]
