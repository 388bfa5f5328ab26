"""Velocities that are drawn: by speed, by temperature, and in the equilibrium of a Plummer sphere."""

from functools import partial

import numpy as np

from particles_mpi.initial.blocks import Block
from particles_mpi.initial.plummer import centered, plummer_speeds, plummer_velocities
from particles_mpi.initial.random_numbers import directions, draw, normals, stream_key, uniform
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exact_sum import exact_sums
from particles_mpi.particles import Array
from particles_mpi.scene.schema import Scene


def random_velocities(ranks: Communicator, scene: Scene, block: Block, own: dict[str, Array]) -> Array:
    """Velocities (n, d) of this rank's part of a population, by its `velocity`; `own`: positions, masses, `fixed`. Collective."""
    population, numbers = block.population, block.numbers
    value, d = population.velocity, scene.dimension
    key = stream_key(scene.seed, block.number, "velocity")
    if value == "equilibrium":
        gravity = scene.effects["mutual_gravity"]
        G = scene.G if gravity.G is None else gravity.G
        speeds = draw(key, *numbers, plummer_speeds)
        return plummer_velocities(ranks, speeds, own["position"], population.position["plummer"], own["mass"], G)
    if "temperature" in value:
        normal = draw(key, *numbers, partial(normals, width=d))
        return warm(ranks, float(value["temperature"]), normal, own["mass"], own["fixed"] == 0)
    speed = value["speed"]
    if isinstance(speed, dict):
        speeds = draw(stream_key(scene.seed, block.number, "speed"), *numbers, uniform)
        speed = (speed["min"] + speeds * (speed["max"] - speed["min"]))[:, None]
    return draw(key, *numbers, partial(directions, d=d)) * speed


def warm(ranks: Communicator, temperature: float, normal: Array, mass: Array, movable: Array) -> Array:
    """Maxwellian: variance T/m a component, without drift of the whole, and scaled so that sum m v^2 = d N T. Collective.

    `normal` (n, d): numbers of a normal distribution; those that are not `movable` (n,) get no velocity.
    """
    v = np.zeros_like(normal)
    m = mass[movable][:, None]
    v[movable] = own = normal[movable] * np.sqrt(temperature / m)
    count = ranks.total(len(own))[0]
    if count > 1:
        own = centered(ranks, own, m[:, 0])
        energy = exact_sums(ranks, [(m * own**2).ravel()])[0]
        v[movable] = own * np.sqrt(count * normal.shape[1] * temperature / energy) if energy > 0.0 else own
    return v
