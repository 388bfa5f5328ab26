"""A model of the seconds of a step with N particles on P ranks, fitted to measurements, and extrapolated beyond them.

    t = fixed + imbalance * each * work(N)/P + row * rows(N, P) + latency * stages(P) + bytes for all others / bandwidth

work(N): N, N log2 N (tree) or N^2 (direct sum). rows: particles of others that a rank fetches in a step, those within
a layer around its block of space. stages: messages one after the other: one to each neighbour, log2 P for a reduction, and for
an exchange in which every rank tells every other how many rows come (J. Bruck et al., IEEE TPDS 8, 1143, 1997). Bytes for all
others: what a rank sends P - 1 times. The costs are fitted to the phases by non-negative least squares of relative errors
(Lawson and Hanson 1974); the numbers of rows, messages, reductions and bytes are counted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import ceil, log2, prod
from statistics import median

import numpy as np
from scipy.optimize import brentq, nnls

NETWORK_LATENCY = 2e-6  # seconds of a short message between two nodes, Infiniband
NETWORK_BANDWIDTH = 1e10  # bytes a second of a rank
ASSUMPTIONS = """work: {growth}; {share}, with memory as fast as here, however many ranks a node has
rows: the layer around a block of space stays equally thick; bisection makes the blocks; one row costs as much as here
messages: one stage of a reduction, or a message to one neighbour, costs as much as here; searches are equally frequent
between nodes (more than {ranks} ranks): at least {latency:.0f} us per message, {bandwidth:.0f} GB/s per rank; no other traffic
not included: new cuts of space, output, set-up, noise of the operating system, which grows with the number of ranks"""


@dataclass(frozen=True)
class Point:
    """One scene on so many ranks, measured. Seconds and counts are those of a step; counts also of one rank, on average.

    own: seconds that a rank computes, mean over the ranks, and of the `slowest`; talk: seconds in phases that communicate, of
    the rank that waits least; phases: seconds by phase; oversubscribed: did ranks share cores? most: largest counts of a rank.
    """

    particles: int
    ranks: int
    seconds: float
    low: float
    high: float
    own: float
    slowest: float
    talk: float
    counts: dict[str, float]
    phases: dict[str, float] = field(default_factory=dict)
    oversubscribed: bool = False
    most: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Law:
    """How work and traffic of a scene grow with the numbers of particles and ranks.

    growth: "N", "N log N" or "N^2"; edges: of the space of the scene, scaled to a volume of 1; fetches_all: does a rank fetch all
    particles; shared: is the work divided among the ranks, or done by each of them?
    """

    growth: str
    edges: tuple[float, ...]
    periodic: tuple[bool, ...]
    fetches_all: bool = False
    shared: bool = True

    def work(self, particles: float) -> float:
        """Return the units of work that all ranks together do in a step."""
        return particles * {"N": 1.0, "N log N": log2(max(particles, 2)), "N^2": particles}[self.growth]

    def share(self, particles: float, ranks: int) -> float:
        """Return the units of work that one of the ranks does in a step."""
        return self.work(particles) / (ranks if self.shared else 1)

    def rate(self, particles: float, ranks: int, seconds: float) -> float:
        """Return the units of work per rank and second, if a step takes `seconds`."""
        return self.work(particles) / (ranks * seconds)

    def cuts(self, ranks: int) -> list[float]:
        """Return the number of blocks along each axis: the longest edge is halved repeatedly. Fractions between powers of two."""
        blocks, left = [1.0] * len(self.edges), float(ranks)
        while left > 1.0:
            k = max(range(len(blocks)), key=lambda axis: self.edges[axis] / blocks[axis])
            blocks[k] *= min(left, 2.0)
            left /= 2.0
        return blocks

    def sides(self, ranks: int) -> list[float]:
        """Return for each axis on how many of its two sides a block has a neighbour, mean over the ranks."""
        both = ((2.0 * (1.0 - 1.0 / n), wraps) for n, wraps in zip(self.cuts(ranks), self.periodic, strict=True))
        return [min(2.0, 2.0 * side) if wraps else side for side, wraps in both]

    def neighbours(self, ranks: int) -> float:
        """Return the number of ranks whose blocks touch the block of a rank, at corners too, mean over the ranks."""
        return min(ranks - 1.0, prod(1.0 + side for side in self.sides(ranks)) - 1.0)

    def rows(self, particles: float, ranks: int, thickness: float) -> float:
        """Return the rows that a rank fetches at a time.

        `thickness`: of the layer around its block, in mean distances between particles; with `fetches_all` there is no layer,
        and it is how often each particle of the other ranks is fetched, about 1.
        """
        if self.fetches_all:
            return thickness * (particles - particles / ranks)
        lengths = [edge * particles ** (1.0 / len(self.edges)) for edge in self.edges]
        blocks = zip(lengths, self.cuts(ranks), self.sides(ranks), strict=True)
        return prod(min(length, length / n + thickness * side) for length, n, side in blocks) - particles / ranks

    def thickness(self, particles: float, ranks: int, rows: float) -> float:
        """Return the thickness of the layer that holds so many rows, in mean distances between particles."""
        if self.fetches_all:
            return rows / (particles - particles / ranks)
        most = max(self.edges) * particles ** (1.0 / len(self.edges))
        if rows <= 0.0 or self.rows(particles, ranks, most) <= rows:
            return most if rows > 0.0 else 0.0
        return float(brentq(lambda t: self.rows(particles, ranks, t) - rows, 0.0, most))


@dataclass(frozen=True)
class Model:
    """What a rank does in a step, and what that costs in seconds.

    thickness: of the layer of rows that is fetched `fetches` times, in mean distances; messages: to one neighbour; all_to_alls:
    exchanges of all with all; for_each: bytes for each of the other ranks, wherever it is.

    Costs: `fixed` of a step, `each` of a unit of work, `row` of a row of row_bytes, `latency` of a stage. imbalance: work of the
    slowest rank over the mean; measured: ranks up to which it was fitted, in one machine; beyond them the latency and the
    bandwidth of a network come in.
    """

    law: Law
    thickness: float
    fetches: float
    messages: float
    reductions: float
    all_to_alls: float
    row_bytes: float
    measured: int
    imbalance: float
    fixed: float = 0.0
    each: float = 0.0
    row: float = 0.0
    latency: float = 0.0
    for_each: float = 0.0

    def rows(self, particles: float, ranks: int) -> float:
        """Return the rows that a rank fetches in a step."""
        return self.fetches * self.law.rows(particles, ranks, self.thickness) if ranks > 1 else 0.0

    def stages_for(self, ranks: int) -> dict[str, float]:
        """Return the consecutive messages of a rank in a step, by purpose."""
        depth, neighbours = ceil(log2(ranks)), self.law.neighbours(ranks)
        collective = {"reductions": self.reductions * depth, "exchanges of all with all": self.all_to_alls * depth}
        return {"messages to neighbours": self.messages * neighbours} | collective

    def stages(self, ranks: int) -> float:
        """Return the number of these messages."""
        return sum(self.stages_for(ranks).values())

    def parts(self, particles: float, ranks: int) -> dict[str, float]:
        """Return the seconds of a step, term by term."""
        row, latency, byte = self.row, self.latency, 0.0
        if ranks > self.measured:
            byte = 1.0 / NETWORK_BANDWIDTH
            row, latency = row + self.row_bytes * byte, max(latency, NETWORK_LATENCY)
        return {
            "fixed": self.fixed,
            "work": (self.imbalance if ranks > 1 else 1.0) * self.each * self.law.share(particles, ranks),
            "rows": row * self.rows(particles, ranks),
            "latency": latency * self.stages(ranks),
            "all_others": byte * self.for_each * (ranks - 1),
        }

    def losses(self, particles: float, ranks: int, weak: bool) -> dict[str, float]:
        """Return the seconds of a step that do not fall with the number of ranks, by cause.

        `weak`: the number of particles of a rank is constant, and with it what a step costs apart from particles does no harm.
        """
        parts, stages = self.parts(particles, ranks), self.stages_for(ranks)
        terms = {f"latency of {name}": parts["latency"] * n / max(self.stages(ranks), 1e-300) for name, n in stages.items()}
        terms |= {"rows of ghosts": parts["rows"], "bytes for all other ranks": parts["all_others"]}
        return terms if weak else terms | {"fixed costs of a step": parts["fixed"]}

    def seconds(self, particles: float, ranks: int) -> float:
        return sum(self.parts(particles, ranks).values())

    def efficiency(self, particles: float, ranks: int, alone: float) -> float:
        """Return the efficiency compared with `alone` particles on one rank."""
        return self.law.rate(particles, ranks, self.seconds(particles, ranks)) / self.law.rate(alone, 1, self.seconds(alone, 1))

    def residual(self, point: Point) -> float:
        """Return the relative error of the model at a measured point."""
        return self.seconds(point.particles, point.ranks) / point.seconds - 1.0

    @property
    def assumptions(self) -> list[str]:
        network = {"latency": NETWORK_LATENCY * 1e6, "bandwidth": NETWORK_BANDWIDTH * 1e-9}
        alone = "all of it on every rank, as long as ranks do not divide space"
        share = "shared as evenly as measured" if self.law.shared else alone
        return ASSUMPTIONS.format(growth=self.law.growth, share=share, ranks=self.measured, **network).splitlines()


def fit(points: Sequence[Point], law: Law, row_bytes: float) -> Model:
    """Fit the model to measured points: counts of all of them, seconds only of ranks that did not share a core."""
    parallel, timed = [p for p in points if p.ranks > 1], [p for p in points if not p.oversubscribed]
    several, widest = [p for p in timed if p.ranks > 1], [p for p in parallel if p.ranks == max(q.ranks for q in parallel)]
    fetching = [p for p in parallel if p.counts["fetches"]]
    layers = [law.thickness(p.particles, p.ranks, p.counts["rows"] / p.counts["fetches"]) for p in fetching]
    names = ("fetches", "reductions", "all_to_alls")
    fetches, reductions, all_to_alls = (median(p.counts[name] for p in widest) for name in names)
    messages, measured = median(p.counts["messages"] / law.neighbours(p.ranks) for p in widest), max(p.ranks for p in timed)
    for_each = median((p.counts["bytes_gathers"] + p.counts["bytes_counts"]) / (p.ranks - 1) for p in widest)
    imbalance = median([p.slowest / p.own for p in several] or [1.0])
    thickness = median(layers or [0.0])
    model = Model(law, thickness, fetches, messages, reductions, all_to_alls, row_bytes, measured, imbalance)
    computing = [[1.0, law.share(p.particles, p.ranks), model.rows(p.particles, p.ranks)] for p in timed]
    fixed, each, row = costs(computing, [p.own for p in timed])
    talkers = [p for p in several if p.talk > 0.0]  # none where no phase is communication alone
    talking = [[model.rows(p.particles, p.ranks), model.stages(p.ranks)] for p in talkers]
    row_sent, latency = costs(talking, [p.talk for p in talkers]) if talkers else (0.0, 0.0)
    return replace(model, fixed=fixed, each=each, row=row + row_sent, latency=latency, for_each=for_each)


def costs(units: Sequence[Sequence[float]], seconds: Sequence[float]) -> list[float]:
    """Return costs >= 0 for which units . costs is nearest to `seconds` (all > 0): least squares of relative errors."""
    table = np.array(units, float) / np.array(seconds, float)[:, None]
    scale = np.sqrt((table**2).sum(axis=0))
    scale[scale == 0.0] = 1.0
    found, _ = nnls(table / scale, np.ones(len(table)))
    return (found / scale).tolist()
