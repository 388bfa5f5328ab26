"""One ball that bounces, on a floor, a tilted plane, a fixed or a free sphere, under each force, with each loss: its true path.

`Bounces` holds many such problems at once, a row each. They are solved by the classical Runge-Kutta method of order 4 in
short steps that end where the ball touches, found by Newton's method: smooth pieces, so order 4 with contacts too. The same
problems stand side by side in one scene, far apart, and the phases of a step at which they touch are spread evenly.
"""

from dataclasses import dataclass
from itertools import product
from math import cos, sin
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.contacts.law import loss
from particles_mpi.particles import Array
from particles_mpi.study.experiment import all_particles

FORCES = ("uniform_gravity", "user_acceleration", "mutual_gravity direct", "mutual_gravity tree")
OBSTACLES = ("floor", "tilted plane", "fixed sphere", "free sphere")
LOSSES: dict[str, dict[str, float]] = {"e = 1": {}, "e = 0.5": {"restitution": 0.5}, "damping 0.5": {"damping": 0.5}}
Cases = tuple[tuple[str, str], ...]  # (obstacle, resistance), the latter "none", "drag" or "friction"
PHASES = 10
DURATION = 1.0
G, DRAG, FRICTION = 9.81, 0.5, 0.8  # friction: alpha
BALL, PLANET = 0.1, 1.0  # radii
MASS, HEAVY = 0.8, 4.0  # of the ball, of a free partner
TILT = 0.3
STRENGTH = 1.5  # Newton's constant
REFERENCE_STEP = 0.01  # step of the reference


@dataclass
class Bounces:
    """Many problems, one a row: body 0 is the ball, body 1 its partner or what attracts it; x, v (n, 2, d), w = 1/m (n, 2).

    a (n, 2, d): constant accelerations; pull (n, 2): G m of what attracts each body; k (n,): rate of drag; alpha (n,): force
    of friction; normal (n, d): of the plane through the origin, or 0 where the obstacle is the partner.
    """

    x: Array
    v: Array
    w: Array
    a: Array
    pull: Array
    k: Array
    alpha: Array
    normal: Array
    loss: dict[str, float]

    def rate(self, x: Array, v: Array) -> Array:
        """dv/dt."""
        a = self.a - self.k[:, None, None] * v
        r = x[:, 1] - x[:, 0]
        r3 = ((r**2).sum(axis=1) ** 1.5)[:, None]
        a[:, 0] += self.pull[:, :1] * r / r3
        a[:, 1] -= self.pull[:, 1:] * r / r3
        speed = np.sqrt((v**2).sum(axis=2, keepdims=True))
        a -= self.alpha[:, None, None] * self.w[:, :, None] * v / np.where(speed > 0.0, speed, 1.0)
        return np.asarray(a * (self.w > 0.0)[:, :, None])

    def after(self, h: Array) -> tuple[Array, Array]:
        """Return (x, v) after a time h (n,), if nothing is in the way."""
        x, v, h = self.x, self.v, h[:, None, None]
        v1, a1 = v, self.rate(x, v)
        v2, a2 = v + 0.5 * h * a1, self.rate(x + 0.5 * h * v1, v + 0.5 * h * a1)
        v3, a3 = v + 0.5 * h * a2, self.rate(x + 0.5 * h * v2, v + 0.5 * h * a2)
        v4, a4 = v + h * a3, self.rate(x + h * v3, v + h * a3)
        return x + h / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4), v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)

    def gap(self, x: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return (distance to the obstacle, its rate of change, normal (n, d))."""
        wall = (self.normal != 0.0).any(axis=1)
        r, u = x[:, 0] - x[:, 1], v[:, 0] - v[:, 1]
        distance = np.sqrt((r**2).sum(axis=1))
        n = np.where(wall[:, None], self.normal, r / distance[:, None])
        gap = np.where(wall, (x[:, 0] * n).sum(axis=1) - BALL, distance - BALL - PLANET)
        return gap, np.where(wall, (v[:, 0] * n).sum(axis=1), (u * n).sum(axis=1)), n

    def advance(self, time: Array) -> None:
        """Advance all rows by `time` (n,), through their contacts."""
        left = time.copy()
        e, keep = loss(self.loss.get("restitution"), self.loss.get("damping"))
        w = np.where((self.normal != 0.0).any(axis=1)[:, None], [1.0, 0.0], self.w)
        while (left > 0.0).any():
            full = h = np.minimum(left, REFERENCE_STEP)
            x, v = self.after(h)
            gap, speed, _ = self.gap(x, v)
            hit = (gap < 0.0) & (speed < 0.0)
            if hit.any():
                for _ in range(6):
                    h = np.where(hit, np.clip(h - gap / np.where(hit, speed, 1.0), 0.0, full), full)
                    x, v = self.after(h)
                    gap, speed, n = self.gap(x, v)
                take = (1.0 + e) * speed / w.sum(axis=1)
                turned = v - (take[:, None] * w)[:, :, None] * n[:, None, :] * [[[1.0], [-1.0]]]
                v = np.where(hit[:, None, None], keep * turned, v)
            self.x, self.v, left = x, v, left - h


def problem(d: int, force: str, obstacle: str, resistance: str) -> dict[str, Any]:
    """A row of `Bounces`, by its fields: the plane, if there is one, goes through the origin."""
    up, along, across = (np.eye(d)[k] for k in (1, 0, d - 1))
    tilted = sin(TILT) * along + cos(TILT) * up
    normal = {"floor": up, "tilted plane": tilted}.get(obstacle, np.zeros(d))
    wall, free = bool(normal.any()), obstacle == "free sphere"
    ball = 1.0 * up + BALL * up if wall else (PLANET + BALL + 0.9) * up + 0.25 * along
    v = 0.8 * along + 0.3 * (across if d > 2 else 0.0 * up)
    partner = 1.5 * PLANET * up + 3.0 * along if wall else np.zeros(d)
    w = np.array([1.0 / MASS, 1.0 / HEAVY if free else 0.0])
    a, pull = np.zeros((2, d)), np.zeros(2)
    if force == "uniform_gravity":
        a[:] = -G * up
        v = v - (2.0 * up if free else 0.0)
    elif force == "user_acceleration":
        a[0], a[1] = -G * up + 0.5 * along, 1.5 * up - 0.7 * along
    else:
        pull[:] = (HEAVY, MASS) if free else (HEAVY, 0.0)
        pull *= STRENGTH
        v = v - (3.0 * up if wall else 0.8 * up)
    start = {"x": np.stack((ball, partner)), "v": np.stack((v, 0.4 * free * (along - up))), "w": w, "a": a, "pull": pull}
    return start | {"normal": normal, "k": DRAG * (resistance == "drag"), "alpha": FRICTION * (resistance == "friction")}


def bounces(d: int, force: str, lost: str, cases: Cases, h: float) -> Bounces:
    """The cases (obstacle, resistance), each PHASES times: moved on along its path by a part of a step h."""
    rows = [problem(d, force, *case) for case in cases for _ in range(PHASES)]
    columns = {name: np.array([row[name] for row in rows], float) for name in rows[0]}
    all_ = Bounces(**columns, loss=LOSSES[lost])
    all_.advance(np.tile(np.arange(PHASES) / PHASES * h, len(cases)))
    return all_


def scene(force: str, mode: str, h: float, start: Bounces) -> tuple[dict[str, Any], Array]:
    """Return the problems side by side as tables of a scene, and the shift of each (n, d). All have friction, or none has."""
    d, attracted, wall = start.x.shape[2], force.startswith("mutual"), (start.normal != 0.0).any(axis=1)
    shift = np.zeros_like(start.x[:, 0])  # away from the foot of the slope, which rises to the left
    far = (1e6 if attracted else 100.0) * np.arange(1, len(shift) + 1)
    tilted = start.normal[:, 0] != 0.0
    shift[:, 0] = np.where(tilted, far * -start.normal[:, 1], far)
    shift[:, 1] = np.where(tilted, far * start.normal[:, 0], np.where(wall, 0.0, 50.0))
    x, particles = start.x + shift[:, None, :], []
    for body, i in product((0, 1), range(len(x))):
        if body == 0 or attracted or not wall[i]:
            radius = BALL if body == 0 or wall[i] else PLANET
            one = {"position": [x[i, body].tolist()], "radius": radius, "mass": (MASS, HEAVY)[body]}
            one |= {"velocity": [start.v[i, body].tolist()]} if start.w[i, body] else {"fixed": True}
            one |= {"acceleration": start.a[i, body].tolist()} if force == "user_acceleration" else {}
            particles.append(one | ({"drag": float(start.k[i])} if start.k.any() else {}))
    planes = [{"point": [0.0] * d, "normal": normal.tolist()} for normal in np.unique(start.normal[wall], axis=0)]
    options: dict[str, Any] = {"acceleration": start.a[0, 0].tolist()} if force == "uniform_gravity" else {}
    effects: dict[str, Any] = {"collisions": {"mode": mode, **start.loss}}
    effects |= {"walls": {"planes": planes, **start.loss}} if planes else {}
    effects |= {"mutual_gravity": {"G": STRENGTH, "method": force.split()[1]}} if attracted else {force: options}
    effects |= {"drag": {}} if start.k.any() else {}
    effects |= {"friction": {"strength": FRICTION}} if start.alpha.any() else {}
    return {"dimension": d, "time": {"step": h, "end": DURATION}, "particles": particles, "effects": effects}, shift


def mean_errors(sim: Simulation, shift: Array, end: Bounces) -> Array:
    """Return for each case the mean distance over the phases of the ball from its true position at the `end`. Collective."""
    x = all_particles(sim).position[: len(shift)] - shift
    return np.asarray(np.sqrt(((x - end.x[:, 0]) ** 2).sum(axis=1)).reshape(-1, PHASES).mean(axis=1))
