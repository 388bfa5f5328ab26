"""G: drag and friction. Leapfrog, which advances them exactly, against PBPhys's explicit rule, and where a long step leads.

And bounces: their order under every force, on every obstacle, with every loss.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import exp
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from particles_mpi import Simulation
from particles_mpi.measure import snapshot
from particles_mpi.particles import Array
from particles_mpi.study.accuracy.bouncing import FORCES, LOSSES, OBSTACLES, bounces, off, scene
from particles_mpi.study.accuracy.bouncing import T as BOUNCING
from particles_mpi.study.measuring.experiment import Errors, Experiment, Lab, Setting, slope

G, DRAG, T, THROW = 9.81, 0.5, 2.0, (10.0, 10.0)
STEPS, QUICK_STEPS = (2, 4, 16, 64, 256), (8, 16, 32, 64)
REPEATS = 200  # particles alike, so that a run is no mere overhead
STIFF = 20.0  # k T of the stiff case
BOUNCES = (0.01, 0.005, 0.0025, 0.00125)  # steps
ENDLESS = 10**9  # steps that are timed without a new start: all cost the same


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


def problem(velocity: tuple[float, ...], n: int, integrator: str, effects: dict[str, Any]) -> dict[str, Any]:
    """Particles thrown in a plane under gravity and a loss."""
    alike = {"position": [[0.0, 0.0]] * REPEATS, "velocity": list(velocity), "mass": 1.0}
    return {
        "dimension": 2,
        "time": {"step": T / n, "steps": n, "integrator": integrator},
        "particles": [alike],
        "effects": {"uniform_gravity": {"acceleration": [0.0, -G]}, **effects},
    }


def settings(lab: Lab, cases: dict[str, dict[str, Any]], true: tuple[Array, Array]) -> Iterator[Setting]:
    """Each curve over a range of steps."""

    def errors(sim: Simulation) -> Errors:
        sim.run()
        p = snapshot.gather_all(sim.ranks, sim.particles)
        return {"place": float(np.abs(p.position[0] - true[0]).max()), "velocity": float(np.abs(p.velocity[0] - true[1]).max())}

    def one(curve: str, n: int, case: dict[str, Any]) -> Setting:
        return Setting(curve, T / n, lambda: lab.simulate(problem(n=n, **case)), ENDLESS, errors, told=n)

    for curve, case in cases.items():
        for n in QUICK_STEPS if lab.quick else STEPS:
            yield one(curve, n, case)


def experiment(
    lab: Lab, key: str, title: str, cases: dict[str, dict[str, Any]], true: tuple[Array, Array], how: str
) -> Experiment:
    """Curves of one problem."""
    rows = lab.measure(title, list(settings(lab, cases, true)))
    errors = {"place": f"distance from the true place at t = {T:g}", "velocity": "the same of the velocity"}
    found = Experiment(key, title, "step", errors, how, rows, (1.0, 2.0), 1e-12)
    for curve in found.curves:
        fine = [row for row in found.curve(curve) if row.errors["place"] > 1e-9][-3:]
        found.answers.append(f"{curve}: order {slope(fine, 'place'):.2f} in place")
    return found


def drag(lab: Lab) -> Experiment:
    """Thrown against the air."""
    cases = {
        name: {"velocity": THROW, "integrator": name, "effects": {"drag": {"rate": DRAG}}} for name in ("leapfrog", "taylor")
    }
    found = experiment(lab, "G1", "Throw with drag", cases, thrown(DRAG), "exact: x(t) of linear drag")
    best = max(row.errors["velocity"] for row in found.curve("leapfrog"))
    found.answers.append(f"leapfrog has the velocity right at any step: error <= {best:.0e}")
    return found


def stiff(lab: Lab) -> Experiment:
    """Drag that stops within a step: k h from 20 downwards."""
    rate = STIFF / T
    cases = {
        name: {"velocity": THROW, "integrator": name, "effects": {"drag": {"rate": rate}}} for name in ("leapfrog", "taylor")
    }
    found = experiment(lab, "G2", f"Stiff drag, k = {rate:g}", cases, thrown(rate), "exact: x(t) of linear drag")
    first = found.curve("taylor")[0]
    found.answers.append(
        f"at k h = {rate * first.setting.knob:.3g} taylor is wrong by {first.errors['velocity']:.1g} in velocity, leapfrog by "
        f"{found.curve('leapfrog')[0].errors['velocity']:.0e}"
    )
    return found


def friction(lab: Lab) -> Experiment:
    """Thrown sideways with friction as strong as the weight: it falls at half the speed in the end."""
    cases = {"leapfrog": {"velocity": (THROW[0], 0.0), "integrator": "leapfrog", "effects": {"friction": {"strength": G}}}}
    return experiment(lab, "G3", "Throw with friction", cases, sliding(), "Runge-Kutta of order 8 (DOP853) at 1e-13")


def bounce(lab: Lab, force: str, lost: str, resistances: tuple[str, ...], h: float) -> Setting:
    """Balls that bounce for a second, on all obstacles."""
    cases = tuple(product(OBSTACLES, resistances))
    start = bounces(2, force, lost, cases, h)
    tables, shift = scene(force, "rewind", h, start)

    def errors(sim: Simulation) -> Errors:
        sim.run()
        end = bounces(2, force, lost, cases, h)
        end.advance(np.full(len(shift), BOUNCING))
        wrong = off(sim, shift, end).reshape(len(OBSTACLES), -1).max(axis=1)
        return dict(zip(OBSTACLES, wrong.tolist(), strict=True))

    curve = f"{force}, {lost}, {'friction' if 'friction' in resistances else 'no drag and drag'}"
    return Setting(curve, h, lambda: lab.simulate(tables), ENDLESS, errors, told=round(BOUNCING / h))


def bouncing(lab: Lab) -> Experiment:
    """Contacts at any moment of a step."""
    title = "Bounces"
    steps = BOUNCES[:2] if lab.quick else BOUNCES
    curves = product(FORCES[:3] if lab.quick else FORCES, LOSSES, (("none", "drag"), ("friction",)))
    rows = lab.measure(title, [bounce(lab, force, lost, with_, h) for force, lost, with_ in curves for h in steps])
    told = {name: f"distance from the true place after a second, mean over the phases of a step: {name}" for name in OBSTACLES}
    how = "Runge-Kutta of order 4 from contact to contact"
    found = Experiment("G4", title, "step", told, how, rows, (2.0,), 1e-9)
    orders = [slope(found.curve(curve), name) for curve in found.curves for name in OBSTACLES]
    most = max(max(found.curve(curve)[0].errors.values()) for curve in found.curves)
    found.answers.append(f"order {min(orders):.2f} to {max(orders):.2f}; error at a step of {steps[0]:g} at most {most:.1e}")
    return found


def measure(lab: Lab) -> list[Experiment]:
    return lab.ranks.run_on_root(lambda: [case(lab.alone()) for case in (drag, stiff, friction, bouncing)]) or []
