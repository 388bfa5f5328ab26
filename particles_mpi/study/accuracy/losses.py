"""G: drag and friction. Leapfrog, which advances them exactly, against PBPhys's explicit rule, and where a long step leads.

And bounces: their order under every force, on every obstacle, with every loss.
"""

from __future__ import annotations

from itertools import product
from math import exp
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from particles_mpi import Simulation
from particles_mpi.particles import Array
from particles_mpi.study.accuracy.bouncing import FORCES, LOSSES, OBSTACLES, bounces, mean_errors, scene
from particles_mpi.study.accuracy.bouncing import T as BOUNCING
from particles_mpi.study.experiment import Benchmark, Errors, Experiment, Setting, everyone, slope

G, DRAG, T, THROW = 9.81, 0.5, 2.0, (10.0, 10.0)
STEPS, QUICK_STEPS = (2, 4, 16, 64, 256), (8, 16, 32, 64)
REPEATS = 200  # particles alike, so that a run is no mere overhead
STIFF = 20.0  # k T of the stiff case
BOUNCES = (0.01, 0.005, 0.0025, 0.00125)  # steps
ENDLESS = 10**9  # steps that are timed without a new start: all cost the same
ERRORS = {"place": f"distance from the true place at t = {T:g}", "velocity": "the same of the velocity"}


def thrown(drag: float, t: float = T) -> tuple[Array, Array]:
    """Place and velocity under gravity and linear drag: dv/dt = g - k v."""
    g, v0 = np.array([0.0, -G]), np.array(THROW)
    decay = exp(-drag * t)
    return g / drag * t + (v0 - g / drag) * (1.0 - decay) / drag, g / drag + (v0 - g / drag) * decay


def sliding(t: float = T) -> tuple[Array, Array]:
    """The same under friction of the weight, alpha = m g, thrown sideways: a Runge-Kutta method of order 8 at 1e-13."""

    def rate(_: float, state: Array) -> Array:
        v = state[2:]
        return np.array([*v, *(np.array([0.0, -G]) - G * v / np.sqrt((v**2).sum()))])

    end = solve_ivp(rate, (0.0, t), [0.0, 0.0, THROW[0], 0.0], "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    return end[:2], end[2:]


def experiment(
    benchmark: Benchmark, key: str, title: str, integrators: tuple[str, ...], velocity: tuple[float, float],
    loss: dict[str, Any], true: tuple[Array, Array], reference: str,
) -> Experiment:  # fmt: skip
    """Particles thrown in a plane under gravity and a loss: each integrator over a range of steps, and the orders seen."""

    def errors(sim: Simulation) -> Errors:
        sim.run()
        p = everyone(sim)
        return {"place": float(np.abs(p.position[0] - true[0]).max()), "velocity": float(np.abs(p.velocity[0] - true[1]).max())}

    def setting(integrator: str, n: int) -> Setting:
        tables = {
            "dimension": 2,
            "time": {"step": T / n, "steps": n, "integrator": integrator},
            "particles": [{"position": [[0.0, 0.0]] * REPEATS, "velocity": list(velocity), "mass": 1.0}],
            "effects": {"uniform_gravity": {"acceleration": [0.0, -G]}, **loss},
        }
        return benchmark.setting(integrator, T / n, tables, errors, steps=ENDLESS, seconds_of=n)

    steps = QUICK_STEPS if benchmark.quick else STEPS
    rows = benchmark.measure(title, [setting(integrator, n) for integrator in integrators for n in steps])
    found = Experiment(key, title, "step", ERRORS, reference, rows, (1.0, 2.0), 1e-12)
    for curve in found.curves:
        fine = [row for row in found.curve(curve) if row.errors["place"] > 1e-9][-3:]
        found.answers.append(f"{curve}: order {slope(fine, 'place'):.2f} in place")
    return found


def drag(benchmark: Benchmark, key: str, title: str, rate: float) -> Experiment:
    """Thrown against the air, by the exact and by the explicit rule."""
    both, loss = ("leapfrog", "taylor"), {"drag": {"rate": rate}}
    return experiment(benchmark, key, title, both, THROW, loss, thrown(rate), "exact: x(t) of linear drag")


def weak_drag(benchmark: Benchmark) -> Experiment:
    """Drag that slows down over many steps."""
    found = drag(benchmark, "G1", "Throw with drag", DRAG)
    best = max(row.errors["velocity"] for row in found.curve("leapfrog"))
    found.answers.append(f"leapfrog has the velocity right at any step: error <= {best:.0e}")
    return found


def stiff_drag(benchmark: Benchmark) -> Experiment:
    """Drag that stops within a step: k h from 20 downwards."""
    rate = STIFF / T
    found = drag(benchmark, "G2", f"Stiff drag, k = {rate:g}", rate)
    exact, explicit = (found.curve(name)[0] for name in ("leapfrog", "taylor"))
    found.answers.append(
        f"at k h = {rate * explicit.setting.parameter:.3g} taylor is wrong by {explicit.errors['velocity']:.1g} in velocity, "
        f"leapfrog by {exact.errors['velocity']:.0e}"
    )
    return found


def friction(benchmark: Benchmark) -> Experiment:
    """Thrown sideways with friction as strong as the weight: it falls at half the speed in the end."""
    loss, how = {"friction": {"strength": G}}, "Runge-Kutta of order 8 (DOP853) at 1e-13"
    return experiment(benchmark, "G3", "Throw with friction", ("leapfrog",), (THROW[0], 0.0), loss, sliding(), how)


def bounce(benchmark: Benchmark, force: str, loss: str, resistances: tuple[str, ...], h: float) -> Setting:
    """Balls that bounce for a second, on all obstacles."""
    cases = tuple(product(OBSTACLES, resistances))
    tables, shift = scene(force, "rewind", h, bounces(2, force, loss, cases, h))

    def errors(sim: Simulation) -> Errors:
        sim.run()
        end = bounces(2, force, loss, cases, h)
        end.advance(np.full(len(shift), BOUNCING))
        wrong = mean_errors(sim, shift, end).reshape(len(OBSTACLES), -1).max(axis=1)
        return dict(zip(OBSTACLES, wrong.tolist(), strict=True))

    curve = f"{force}, {loss}, {'friction' if 'friction' in resistances else 'no drag and drag'}"
    return benchmark.setting(curve, h, tables, errors, steps=ENDLESS, seconds_of=round(BOUNCING / h))


def bouncing(benchmark: Benchmark) -> Experiment:
    """Contacts at any moment of a step."""
    steps = BOUNCES[:2] if benchmark.quick else BOUNCES
    curves = product(FORCES[:3] if benchmark.quick else FORCES, LOSSES, (("none", "drag"), ("friction",)))
    rows = benchmark.measure(
        "Bounces", [bounce(benchmark, force, loss, with_, h) for force, loss, with_ in curves for h in steps]
    )
    errors = {name: f"distance from the true place after a second, mean over the phases of a step: {name}" for name in OBSTACLES}
    reference = "Runge-Kutta of order 4 from contact to contact"
    found = Experiment("G4", "Bounces", "step", errors, reference, rows, (2.0,), 1e-9)
    orders = [slope(found.curve(curve), name) for curve in found.curves for name in OBSTACLES]
    most = max(max(found.curve(curve)[0].errors.values()) for curve in found.curves)
    found.answers.append(f"order {min(orders):.2f} to {max(orders):.2f}; error at a step of {steps[0]:g} at most {most:.1e}")
    return found


def measure(benchmark: Benchmark) -> list[Experiment]:
    """G: four experiments. Collective."""
    return [one(benchmark) for one in (weak_drag, stiff_drag, friction, bouncing)]
