"""Mutual gravity: every particle that has a mass attracts every other one, also if it is fixed."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from particles_mpi.gravity.direct import TILE, Attraction, add_potential, in_tiles
from particles_mpi.gravity.method import TREES, Choice, choose
from particles_mpi.kernels.fingerprint import places_of
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, blocks, rows_in_order
from particles_mpi.parallel.signals import check_signals
from particles_mpi.particles import Array, Particles
from particles_mpi.scene.effect import Context, EffectOptions, Force
from particles_mpi.scene.model import NotNegative
from particles_mpi.scene.schema import Scene

if TYPE_CHECKING:
    from particles_mpi.gravity.tree import TreeResult

ACCURACY = 1e-3
PAIRS = 2 * 10**8  # pairs between two checks of signals


class Options(EffectOptions):
    """`G` is by default that of the scene; `softening` is the length eps, with which pairs attract as Plummer spheres (Aarseth
    1963).

    `method`: "direct" is the sum over all pairs. "tree" is the algorithm of Barnes and Hut: a cell acts as a whole if its radius
    over its distance is below `opening_angle` (0.5 if not given); its `multipole` is a "quadrupole", which includes the mass, or
    a "monopole", the mass alone. "auto" chooses the cheaper of the two whose forces have a median relative error of at most
    `accuracy` (1e-3 if not given), with quadrupoles.
    """

    G: NotNegative | None = None
    softening: NotNegative = 0.0
    method: Literal["direct", "tree", "auto"] = "direct"
    opening_angle: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    multipole: Literal["quadrupole", "monopole"] = "quadrupole"
    accuracy: Annotated[float, Field(gt=0.0, le=0.1)] | None = None

    def faults(self, scene: Scene) -> list[str]:
        d, auto, periodic = scene.dimension, self.method == "auto", any(scene.periodic)
        faults = {
            'method: the forces of a tree jump where cells change, which "adaptive" cannot follow; use "direct"': (
                self.method == "tree" and scene.time.integrator == "adaptive"
            ),
            f'method: there is no tree in dimension {d}; use "direct"': self.method == "tree" and d not in TREES,
            'opening_angle: method "auto" chooses it; give accuracy': self.opening_angle is not None and auto,
            'accuracy: only with method "auto"': self.accuracy is not None and not auto,
            'multipole: "monopole" only with method "tree"': self.multipole == "monopole" and self.method != "tree",
            "method: attraction by images in a periodic box is not computed; use a box that is not periodic, or none": periodic,
        }
        return [fault for fault, wrong in faults.items() if wrong]

    def described(self, scene: Scene, total: int) -> str:
        return self.choice(scene, total).words

    def strength(self, scene: Scene) -> float:
        """Return the effect's own G, or that of the scene if it has none."""
        return scene.G if self.G is None else self.G

    def choice(self, scene: Scene, total: int) -> Choice:
        """How the sum is done for `total` particles, and what it costs."""
        angle, accuracy = self.opening_angle or 0.5, self.accuracy or ACCURACY
        method = "direct" if self.method == "auto" and scene.time.integrator == "adaptive" else self.method
        return choose(method, angle, accuracy, scene.dimension, total, self.multipole)


class Effect(Force):
    """Adds the attraction; its potential energy is shared by both partners of a pair."""

    of_movable = True
    formula = "dv_i/dt = G sum_j m_j (x_j - x_i)/(|x_j - x_i|^2 + eps^2)^(3/2)"
    collective = True

    def __init__(self, options: Options, scene: Scene):
        self.options, self.scene = options, scene
        self.G = options.strength(scene)
        self.softening2 = options.softening**2

    def bind(self, context: Context) -> None:
        angle = self.options.choice(self.scene, context.ids.total).angle
        self.sum: DirectSum | TreeSum
        if angle is None:
            self.sum = self.direct = DirectSum(context.ranks, context.ids, self.G, self.softening2)
        else:
            quadrupoles = self.options.multipole == "quadrupole"
            self.sum = TreeSum(context.ranks, self.scene.dimension, angle, self.softening2, quadrupoles)

    @property
    def interactions(self) -> int:
        return self.sum.interactions

    def add(self, particles: Particles, acceleration: Array) -> None:
        acceleration += self.G * self.sum.pull(particles)

    def potential(self, particles: Particles) -> Array:
        """Return (n,): half of each pair's energy; all of it if the partner is fixed and so not counted. Collective."""
        return self.G * particles.mass * self.sum.potential(particles)


class DirectSum:
    """The sum over all pairs; `pull` and `potential` are for G = 1.

    `G` and `softening2` are kept for `integrators.many_steps`.
    """

    def __init__(self, ranks: Communicator, ids: IdRange, G: float, softening2: float):
        self.ranks, self.ids, self.G, self.softening2 = ranks, ids, G, softening2
        self.interactions = 0  # so far

    def pull(self, p: Particles) -> Array:
        """Accelerations (n, d). Collective."""
        order = rows_in_order(p.id)
        ids, sums = p.id[order], Attraction(p.position[order], self.ids.total, self.softening2)
        for block in blocks(self.ranks, {"id": p.id, "position": p.position, "mass": p.mass}, self.ids):
            x, mass = block["position"], block["mass"]
            own = part_with(block["id"], ids) if sums.lanes > 1 else slice(0, 0)
            for some in slices(0, own.start, len(p)):
                sums.add(x[some], mass[some])
            for some in slices(0, len(sums.at) if own.stop > own.start else 0, TILE * len(p)):
                sums.add_one_another(mass[own], some.start, some.stop)
            for some in slices(own.stop, len(mass), len(p)):
                sums.add(x[some], mass[some])
        self.interactions += len(p) * self.ids.total
        result = np.empty_like(p.position)
        result[order] = sums.accelerations()
        return result

    def potential(self, p: Particles) -> Array:
        """Return the potential (n,), to which movable sources add half of theirs. Collective."""
        at, ids = in_tiles(p.position), in_tiles(p.id)
        total = np.zeros((len(at), TILE))
        for block in blocks(self.ranks, {"id": p.id, "position": p.position, "mass": halved(p)}, self.ids):
            for some in slices(0, len(block["id"]), len(p)):
                x, mass, of = block["position"][some], block["mass"][some], block["id"][some]
                add_potential((0,) * p.dimension, at, ids, x, mass, of, self.softening2, total)
        return total.reshape(-1)[: len(p)]


def part_with(every: Array, ids: Array) -> slice:
    """The slice of a block with the ids `every`, ascending, that has exactly `ids`, ascending; an empty slice if none has."""
    first = int(np.searchsorted(every, ids[0])) if len(ids) else 0
    part = slice(first, first + len(ids))
    return part if np.array_equal(every[part], ids) else slice(0, 0)


def slices(begin: int, end: int, each: int) -> Iterator[slice]:
    """Yield slices of begin ... end - 1 with at most PAIRS pairs, some tenths of a second each; check signals before each.

    `each`: how many pairs one number stands for.
    """
    many = max(1, PAIRS // max(each, 1))
    for first in range(begin, end, many):
        check_signals()
        yield slice(first, min(first + many, end))


class TreeSum:
    """The sum by a tree; `pull` and `potential` are for G = 1."""

    def __init__(self, ranks: Communicator, dimension: int, angle: float, softening2: float, quadrupoles: bool):
        from particles_mpi.gravity.tree import Tree

        self.ranks, self.tree = ranks, Tree(ranks, dimension, angle, softening2, quadrupoles)
        self.interactions = 0  # so far
        self.version, self.work = -1, np.ones(0)
        self.known: tuple[int, ...] = ()  # version, edition and fingerprint of the rows that `depth` belongs to
        self.depth = np.zeros(0)

    def pull(self, particles: Particles) -> Array:
        """Accelerations (n, d). Collective."""
        result = self.sum(particles, particles.mass)
        self.interactions += self.tree.interactions
        self.known, self.depth = places_of(particles), result.potential
        return result.acceleration[:, : particles.dimension]

    def potential(self, p: Particles) -> Array:
        """Return the potential (n,), movable sources counting half; the last `pull` gives it if none is fixed or moved.
        Collective.
        """
        known = self.known == places_of(p) and not p.fixed.any()
        if self.ranks.all(known):
            return 0.5 * self.depth
        return self.sum(p, halved(p)).potential

    def sum(self, p: Particles, mass: Array) -> "TreeResult":
        """Evaluate the tree; as long as rows stay the same, the work of each in the last call divides it among ranks."""
        if self.version != p.version:
            self.version, self.work = p.version, np.ones(len(p))
        result = self.tree.attract(p.id, p.position, mass, self.work)
        self.work = result.work
        return result


def halved(p: Particles) -> Array:
    """Return masses (n,), halved for movable particles, so that each partner of a pair gets its share of the energy."""
    return p.mass * np.where(p.fixed != 0, 1.0, 0.5)
