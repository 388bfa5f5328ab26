"""Particles where ranks meet, and ranks without particles. Under mpirun each is compared, bit for bit, with one rank."""

import numpy as np

from particles_mpi import Simulation
from particles_mpi.study.hard_cases import Bench, case, everyone

HELD = "ids a permutation at every step; same bits on any number of ranks"


def watch(sim: Simulation, steps: int) -> tuple[str, bool]:
    """Steps, after each of which every id must be there once."""
    total, lost = sim.total, 0
    for _ in range(steps):
        sim.step()
        lost += not np.array_equal(everyone(sim).id, np.arange(total))
    counts = sim.ranks.allreduce_sum(np.array([sim.totals["collisions"]]))
    return f"{total} ids at each of {steps} steps, {counts[0]} contacts", lost == 0


@case("on borders and corners of domains", "owned twice, or by nobody", HELD)
def on_borders(bench: Bench) -> tuple[str, bool]:
    """A lattice symmetric about all borders of 2, 4, 8 ranks, and spheres at rest exactly on these."""
    d = bench.dimension
    axis = np.arange(1.0, 16.0, 2.0)
    grid = np.stack(np.meshgrid(*[axis] * d, indexing="ij"), axis=-1).reshape(-1, d)
    corners = np.stack(np.meshgrid(*[[4.0, 8.0, 12.0]] * d, indexing="ij"), axis=-1).reshape(-1, d)
    speeds = np.random.default_rng(5).choice([-4.0, 4.0], size=grid.shape)
    sim = bench.simulate(
        box={"lower": [0.0] * d, "upper": [16.0] * d, "periodic": True},
        time={"step": 0.05, "steps": 1},
        particles=[
            {"position": corners.tolist(), "radius": 0.3},
            {"position": grid.tolist(), "velocity": speeds.tolist(), "radius": 0.3},
        ],
        effects={"collisions": {}},
    )
    return watch(sim, 60)


@case("crossing many domains in a step", "handed to a neighbour only, and lost", HELD)
def crossing(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    cluster = (19.0 + 0.2 * np.stack(np.meshgrid(*[np.arange(10.0)] * d, indexing="ij"), axis=-1)).reshape(-1, d)[::d]
    sim = bench.simulate(
        seed=6,
        box={"lower": [0.0] * d, "upper": [40.0] * d},
        time={"step": 0.35, "steps": 1},
        particles=[
            {"position": cluster.tolist(), "radius": 0.09, "velocity": {"speed": 0.1}},
            {"position": [[5.0 + 30.0 * (k % 2), 9.0 + 7.5 * k] + [20.0] * (d - 2) for k in range(4)], "radius": 2.0,
             "velocity": [[10.0 - 20.0 * (k % 2)] + [0.0] * (d - 1) for k in range(4)]},
        ],
        effects={"collisions": {}, "walls": {}},
    )  # fmt: skip
    return watch(sim, 30)


@case("all particles in one rank's corner", "ranks without work hang", HELD)
def one_corner(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    places = (0.05 + 0.1 * np.stack(np.meshgrid(*[np.arange(4.0)] * d, indexing="ij"), axis=-1)).reshape(-1, d)
    sim = bench.simulate(
        seed=7,
        box={"lower": [0.0] * d, "upper": [1000.0] * d},
        time={"step": 0.01, "steps": 1},
        particles=[{"position": places.tolist(), "radius": 0.04, "velocity": {"speed": 2.0}}],
        effects={"collisions": {}, "walls": {}},
    )
    return watch(sim, 60)


@case("three particles, and none", "more ranks than particles: a hang", HELD)
def few(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    told, held = "", True
    for count in (0, 3):
        places = [[1.0 + 1.5 * k] * d for k in range(count)]
        sim = bench.simulate(
            box={"lower": [0.0] * d, "upper": [10.0] * d},
            time={"step": 0.05, "steps": 1},
            particles=[{"position": places, "radius": 0.5, "velocity": {"speed": 3.0}}]
            if count
            else [{"count": 0, "position": "random", "radius": 0.5}],
            effects={"collisions": {}, "walls": {}},
        )
        told, fine = watch(sim, 60)
        held &= fine
    return told, held
