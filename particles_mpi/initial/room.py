"""The space in which particles are placed at the start."""

from math import exp, lgamma, log, pi
from typing import NamedTuple

import numpy as np

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exact_sum import exact_sums
from particles_mpi.particles import Array
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.schema import Scene


class Room(NamedTuple):
    """The space in which particles are placed, and the walls that they must not touch."""

    lower: Array  # (d,) corners of the box
    upper: Array
    length: Array  # (d,) of periodic axes; 0 for others
    point: Array  # (w, d) a point on each wall
    normal: Array  # (w, d) of each wall, into the space
    solid: bool  # spheres may not overlap one another
    bounded: bool  # spheres stay a radius away from faces of the box that are not periodic


def room_of(scene: Scene) -> Room:
    """Box and walls of a scene as arrays; an open side is infinite."""
    effects = ActiveEffects(scene, switched_off=True)
    walls, solid = effects.planes, effects.pairs is not None
    bounded = solid or len(walls.point) > 0
    return Room(*scene.corners, scene.periodic_length, walls.point, walls.normal, solid, bounded)


def packing_fraction(ranks: Communicator, radius: Array, room: Room) -> float:
    """The volume of the spheres of all ranks with these radii (n,), divided by that of the box. Collective."""
    d, edge = len(room.lower), float(np.exp(np.log(room.upper - room.lower).mean()))  # edge: of a cube with its volume
    return exact_sums(ranks, [(radius / edge) ** d])[0] * exp(0.5 * d * log(pi) - lgamma(0.5 * d + 1.0))
