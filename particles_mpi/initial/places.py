"""Where particles are at the start: given, on a lattice, in a Plummer sphere, or at random."""

from functools import partial
from math import inf

import numpy as np

from particles_mpi.initial.columns import Columns, Share
from particles_mpi.initial.lattices import lattice
from particles_mpi.initial.plummer import centered, plummer_points
from particles_mpi.initial.random_addition import JAMMING_PACKING, RandomAddition
from particles_mpi.initial.random_numbers import draw, stream_key
from particles_mpi.initial.room import Room, packing_fraction
from particles_mpi.particles import Array

DENSEST = {1: 1.0, 2: 0.9069, 3: 0.7405}  # packing of equal spheres


def fill_places(columns: Columns, shares: list[Share], room: Room, scattered: Array) -> None:
    """Lists, files and lattices first, then random places around them, the largest spheres first. Collective.

    `scattered` (n,): which rows of this rank get random places.
    """
    x, radius, ranks = columns.arrays["position"], columns.arrays["radius"], columns.ranks
    largest = {share.number: ranks.largest(radius[share.rows].max(initial=0.0))[0] for share in shares}
    for share in shares:
        given = share.population.position
        if given == "lattice":
            places = lattice(share.total, largest[share.number], room, *share.numbers)
            if places is None:
                fraction = packing_fraction(ranks, radius[share.rows], room)
                why = f"{share.total} spheres do not fit (packing fraction {fraction:.3g})"
                columns.faults.add(f"{share.key}.position: lattice: {why}")
            else:
                x[share.rows] = places
        elif isinstance(given, dict) and "plummer" in given:
            key = stream_key(columns.scene.seed, share.number, "position")
            points = draw(key, *share.numbers, partial(plummer_points, a=given["plummer"]))
            x[share.rows] = centered(ranks, points, columns.arrays["mass"][share.rows])
        elif given != "random":
            columns.fill(share, "position", given)
    columns.faults.stop()
    if random := [share for share in shares if share.population.position == "random"]:
        addition = RandomAddition(ranks, room, x[~scattered], radius[~scattered], [radius[scattered]])
        for share in sorted(random, key=lambda share: -largest[share.number]):
            if fault := scatter(columns, share, room, addition, largest[share.number]):
                columns.faults.add(f"{share.key}.position: random: {fault}")
                return


def scatter(columns: Columns, share: Share, room: Room, addition: RandomAddition, largest: float) -> str:
    """Random places for a population; returns why there are none, or "" . Collective."""
    ranks, dimension = columns.ranks, columns.scene.dimension
    own, count = columns.arrays["radius"][share.rows], share.total
    smallest = ranks.least(own.min(initial=inf))
    wide = np.flatnonzero((room.length == 0.0) & (2.0 * largest > room.upper - room.lower))
    if room.bounded and len(wide):
        return f"spheres of radius {largest:g} do not fit into the box on axis {wide[0]}"
    most, fraction = JAMMING_PACKING.get(dimension, inf), packing_fraction(ranks, own, room)
    if room.solid and count > 1000 and smallest == largest and fraction > most:
        said = f"{count} spheres have packing fraction {fraction:.3g}, above the {most} at which"
        return f"{said} random places run out; {advice(fraction, dimension)}"
    key = int(np.random.Philox(key=stream_key(columns.scene.seed, share.number, "position")).random_raw())
    columns.arrays["position"][share.rows], missing = addition.place(key, np.arange(*share.numbers), own)
    if not missing:
        return ""
    fraction = packing_fraction(ranks, columns.arrays["radius"], room)
    said = f"only {count - missing} of {count} spheres fit after {addition.tries} tries (packing fraction {fraction:.3g})"
    return f"{said}; {advice(fraction, dimension)}"


def advice(fraction: float, dimension: int) -> str:
    """What to do where spheres with this packing fraction find no random places: up to DENSEST a lattice may have them."""
    lattice = "use lattice, or " if fraction < DENSEST.get(dimension, 0.0) else ""
    return f"{lattice}fewer or smaller spheres"
