"""The quantities of the particles of a start, in the order in which they are made: attributes, positions, velocities."""

from functools import partial
from math import inf
from typing import Any

import numpy as np

from particles_mpi.initial.checks import divided_masses
from particles_mpi.initial.columns import Columns, Share
from particles_mpi.initial.lattices import lattice
from particles_mpi.initial.plummer import centered, plummer_points, plummer_velocities, scaled_velocities
from particles_mpi.initial.random_addition import JAMMING_PACKING, RandomAddition
from particles_mpi.initial.random_numbers import directions, draw, stream_key, uniform
from particles_mpi.initial.room import Room, packing_fraction
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exact_sum import exact_sums
from particles_mpi.particles import FIELDS, Array, moment_of_sphere
from particles_mpi.scene.model import LARGEST_NUMBER

AS_GIVEN = ("fixed", "radius", "mass", "drag", "acceleration")  # keys of a population that are filled as they are given
DENSEST = {1: 1.0, 2: 0.9069, 3: 0.7405}  # packing of equal spheres


def fill_attributes(columns: Columns, share: Share) -> None:
    """radius, mass, fixed, spin, and the fields of effects. Collective."""
    scene, population, rows, arrays = columns.scene, share.population, share.rows, columns.arrays
    given: dict[str, Any] = {name: getattr(population, name) for name in AS_GIVEN if name in arrays}
    if "drag" in given and population.drag is None and "drag" in scene.effects:
        given["drag"] = scene.effects["drag"].rate
    given |= population.model_extra or {}  # columns of effects from outside
    for name, value in given.items():
        if value is not None:
            columns.fill(share, name, value)
            least = FIELDS[name].least
            low = f"below {least:g} for" if name in scene.columns else "negative for"
            columns.refuse(share, name, arrays[name][rows] < least, low)
    columns.refuse(share, "fixed", arrays["fixed"][rows] > 1, "neither 0 nor 1 for")
    if "spin" in arrays:
        fill_spins(columns, share)
    for name, needed in divided_masses(scene, arrays["fixed"][rows]).items():
        massless = needed & (arrays["mass"][rows] == 0.0)
        columns.refuse(share, "mass", massless, f"[effects.{name}] divides by it, so it must be above 0 for")


def fill_spins(columns: Columns, share: Share) -> None:
    """Moments of inertia, of solid spheres if not given, and spins; what is fixed has none. Collective."""
    population, d = share.population, columns.scene.dimension
    fixed, mass, radius, moment, spin = (
        columns.arrays[name][share.rows] for name in ("fixed", "mass", "radius", "moment_of_inertia", "spin")
    )
    moment[:] = moment_of_sphere(mass, radius, d)
    if population.moment_of_inertia is not None:
        columns.fill(share, "moment_of_inertia", population.moment_of_inertia)
        columns.refuse(share, "moment_of_inertia", moment < 0.0, "negative for")
        columns.refuse(share, "moment_of_inertia", (moment == 0.0) & (mass > 0.0) & (radius > 0.0) & (fixed == 0), "0 for")
    value = population.spin
    if value is None:
        return
    if isinstance(value, dict) and "temperature" in value:
        key = stream_key(columns.scene.seed, share.number, "spin")
        normal = draw(key, *share.numbers, lambda random, n: random.standard_normal((n, spin.shape[1])))
        turns = (fixed == 0) & (moment > 0.0)
        spin[:] = normal * np.sqrt(value["temperature"] / np.where(turns, moment, np.inf))[:, None]
        return
    columns.fill(share, "spin", [[s] for s in value] if d == 2 and isinstance(value, list) else value)
    columns.refuse(share, "spin", (fixed != 0) & (spin != 0.0).any(axis=1), "must be 0 for fixed")


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
        said = f"{count} spheres have packing fraction {fraction:.3g}, more than the {most} at which"
        return f"{said} no more random positions are found; {advice(fraction, dimension)}"
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


def fill_velocities(columns: Columns, share: Share, shares: list[Share]) -> None:
    """Given, or drawn; what is fixed has none. Collective."""
    value, arrays = share.population.velocity, columns.arrays
    velocity, fixed = arrays["velocity"][share.rows], arrays["fixed"][share.rows] != 0
    if value is None:
        return
    if isinstance(value, list) or "file" in value:
        columns.fill(share, "velocity", value)
        columns.refuse(share, "velocity", fixed & (velocity != 0.0).any(axis=1), "must be 0 for fixed")
        return
    movable = columns.ranks.total(np.count_nonzero(~fixed))[0]
    if value != "equilibrium" and not movable and value not in ({"speed": 0}, {"temperature": 0}):
        columns.refuse(share, "velocity", fixed, "cannot be given for fixed")
        return
    if isinstance(value, dict) and "temperature" in value:
        columns.refuse(share, "velocity", ~fixed & (arrays["mass"][share.rows] == 0.0), "a temperature needs a mass for")
        if columns.faults.found:
            return
    velocity[:] = drawn_velocities(columns, share, shares)
    velocity[fixed] = 0.0
    columns.refuse(share, "velocity", ~(np.abs(velocity) <= LARGEST_NUMBER), f"beyond {LARGEST_NUMBER:g} for")


def drawn_velocities(columns: Columns, share: Share, shares: list[Share]) -> Array:
    """Velocities (n, d) of this rank's part of a population by a speed, a temperature, or in a Plummer sphere. Collective."""
    scene, ranks, numbers, value = columns.scene, columns.ranks, share.numbers, share.population.velocity
    position, mass, fixed = (columns.arrays[name][share.rows] for name in ("position", "mass", "fixed"))
    key = stream_key(scene.seed, share.number, "velocity")
    if value == "equilibrium":
        G, scaled = scene.effects["mutual_gravity"].strength(scene), draw(key, *numbers, scaled_velocities)
        sphere = share.population.position
        whole = np.concatenate([columns.arrays["mass"][of.rows] for of in shares if of.population.position == sphere])
        return plummer_velocities(ranks, scaled, position, sphere["plummer"], mass, G, whole)
    if "temperature" in value:
        normal = draw(key, *numbers, lambda random, n: random.standard_normal((n, scene.dimension)))
        return warm(ranks, float(value["temperature"]), normal, mass, fixed == 0)
    speed = value["speed"]
    if isinstance(speed, dict):
        speeds = draw(stream_key(scene.seed, share.number, "speed"), *numbers, uniform)
        speed = (speed["min"] + speeds * (speed["max"] - speed["min"]))[:, None]
    return draw(key, *numbers, partial(directions, d=scene.dimension)) * speed


def warm(ranks: Communicator, temperature: float, normal: Array, mass: Array, movable: Array) -> Array:
    """Maxwellian velocities (n, d): variance T/m a component, without total momentum, sum m v^2 = d N T. Collective.

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
