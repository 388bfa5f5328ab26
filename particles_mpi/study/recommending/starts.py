"""The start of a scene of the user's, from which all settings that are compared begin, and what kind of scene it is."""

from __future__ import annotations

from typing import Any

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.errors import SceneError
from particles_mpi.initial.checks import check_start, endless_falls, periodic_length
from particles_mpi.initial.populate import effect_class, fields_of, populate, room_of
from particles_mpi.measure import snapshot
from particles_mpi.parallel.agreement import raising_together, same_on_all
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import ALWAYS, FIELDS, Array, Particles, shape
from particles_mpi.study.measuring.experiment import Lab

DIRECT: dict[str, Any] = {"method": "direct", "opening_angle": None, "accuracy": None, "multipole": None}  # sum of forces
SHIFT = 1e-12  # of the size of a motion: how far a displaced start is from the start
FEW = 64  # particles that more than one rank would only slow down
STATELESS = ("contacted", "virial", "rate", "supported", "total_acceleration")  # fields that a run fills itself


def variant(scene: Scene, time: dict[str, Any], effects: dict[str, dict[str, Any] | None] | None = None) -> Scene:
    """The scene with another [time], and with keys of effects changed (None: taken away). SceneError if that is refused."""
    tables = scene.to_dict() | {"time": time}
    for name, keys in (effects or {}).items():
        if keys is None:
            tables["effects"].pop(name)
        else:
            changed = tables["effects"][name] | keys
            tables["effects"][name] = {key: value for key, value in changed.items() if value is not None}
    orphans = {"drag": "drag", "user_acceleration": "acceleration"}
    for table in tables["particles"]:
        for effect, key in orphans.items():
            if effect not in tables["effects"]:
                table.pop(key, None)
        if table.get("velocity") == "equilibrium" and "mutual_gravity" not in tables["effects"]:
            table.pop("velocity")
    return Scene.from_dict(tables, scene.folder)


class Start:
    """All particles of a scene at its start, drawn once."""

    def __init__(self, lab: Lab, scene: Scene):
        self.lab, self.scene = lab, scene
        with raising_together(lab.ranks):
            self.particles, self.warnings = populate(scene)
        same_on_all(lab.ranks, scene.to_dict(), self.particles.arrays)
        self.total = len(self.particles)
        effects = {name: effect_class(name) for name in scene.effects}
        self.contacts = bool({"collisions", "walls"} & effects.keys())
        self.dissipates = bool({"drag", "friction"} & effects.keys())
        self.forces = [name for name, effect in effects.items() if effect.role == "force"]
        lossy = [name for name, effect in effects.items() if getattr(effect(scene.effects[name], scene), "lossy", False)]
        self.conserves = not self.dissipates and not lossy and not endless_falls(scene, self.particles)
        self.duration = scene.steps * scene.time.step

    @property
    def free(self) -> bool:
        """Do all integrators apply: nothing but forces that depend on places?"""
        return not self.contacts and not self.dissipates

    @property
    def length(self) -> Array:
        """Of periodic axes, 0 of others."""
        return periodic_length(self.scene)

    def simulate(self, scene: Scene, shifted: int = 0, duration: float = 0.0, amount: float = SHIFT) -> Simulation:
        """The start in a variant of the scene. Collective. SceneError if it cannot run.

        `shifted`: the number of a start that is displaced by `amount` of the size of what moves, where that leaves no
        overlap, and otherwise by so much of the velocities; `duration` of what follows tells how fast something at rest is.
        """
        p = self.particles
        arrays = {name: p[name].copy() for name in fields_of(scene) if name in p.arrays and name not in STATELESS}
        for name in fields_of(scene):
            if name not in arrays:
                arrays[name] = np.zeros(shape(name, self.total, p.dimension), FIELDS[name].dtype)
        if "contacted" in arrays:
            arrays["contacted"][:] = -np.inf
        assert set(ALWAYS) <= set(arrays)
        faults, _ = check_start(scene, everyone := Particles(p.dimension, arrays), room_of(scene))
        if faults:
            raise SceneError(faults)
        if shifted:
            self.displace(everyone, shifted, duration, amount)
        return Simulation(scene, comm=self.lab.comm, start=everyone)

    def displace(self, p: Particles, number: int, duration: float, amount: float) -> None:
        """Move every movable particle a little, by random numbers keyed by `number` and its id."""
        shift = np.random.Generator(np.random.Philox(key=number)).uniform(-1.0, 1.0, p.position.shape)
        shift[p.fixed != 0] = 0.0
        x, v = p["position"], p["velocity"]
        size = spread(x) or spread(x, np.zeros(p.dimension)) or 1.0
        speed = float(np.sqrt((v**2).sum(axis=1).mean())) if self.total else 0.0
        if self.contacts:
            v += amount * (speed or size / (duration or 1.0)) * shift
        else:
            x += amount * size * shift


def spread(x: Array, center: Array | None = None) -> float:
    """Root of the mean square distance from the centre."""
    return float(np.sqrt(((x - (x.mean(axis=0) if center is None else center)) ** 2).sum(axis=-1).mean())) if len(x) else 0.0


def places(ranks: Communicator, sim: Simulation) -> Array:
    """Positions (N, d) of all, in id order, on every rank. Collective."""
    return snapshot.gather_all(ranks, sim.particles).position
