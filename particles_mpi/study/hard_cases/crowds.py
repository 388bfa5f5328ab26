"""Many contacts at once: chains, racks, collapse, dense fluids."""

import numpy as np

from particles_mpi.kernels.geometry import image_shifts
from particles_mpi.study.hard_cases import Bench, case, everyone


def along(d: int, x: float) -> list[float]:
    """The point at x of the last axis."""
    return [0.0] * (d - 1) + [x]


@case("cradle of 5, column of 50, touching; hit at one end", "several come off, or all move", "the last one leaves, exactly")
def cradle(bench: Bench) -> tuple[str, bool]:
    d, off = bench.dimension, 0.0
    for n in (5, 50):
        sim = bench.simulate(
            time={"step": 0.01 if n == 5 else 0.05, "steps": 100},
            particles=[
                {"position": [along(d, float(k)) for k in range(n)], "radius": 0.5},
                {"position": [along(d, -1.33)], "velocity": along(d, 2.0), "radius": 0.5},
            ],
            effects={"collisions": {"passes": 100} if bench.mode == "rewind" else {}},
        )
        sim.run()
        right = np.zeros((n + 1, d))
        right[n - 1, -1] = 2.0
        off = max(off, float(np.abs(everyone(sim).velocity - right).max()))
    return f"velocities off {off:.0e}", off == 0.0


@case("rack of 15 touching spheres, broken", "order of the array decides", "energy and momentum to round-off", dimensions=(2, 3))
def rack(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    rows = [(i, j) for i in range(5) for j in range(i + 1)]
    places = [[0.75**0.5 * i, j - 0.5 * i] + [0.0] * (d - 2) for i, j in rows]
    sim = bench.simulate(
        time={"step": 0.01, "steps": 300},
        particles=[
            {"position": places, "radius": 0.5},
            {"position": [[-3.0, 0.0] + [0.0] * (d - 2)], "velocity": [4.0] + [0.0] * (d - 1), "radius": 0.5},
        ],
        effects={"collisions": {"passes": 100} if bench.mode == "rewind" else {}},
    )
    sim.run()
    row = sim.measure()
    energy, momentum = abs(row["kinetic"] / 8.0 - 1.0), abs(row["momentum_x"] - 4.0)
    holds = energy <= 1e-14 and momentum <= 1e-14 * 8.0 and int(sim.ranks.allreduce_sum(sim.totals["missed"])[0]) == 0
    return f"energy off {energy:.0e}, momentum {momentum:.0e}", bool(holds)


def collapse(bench: Bench, beads: list[float], speeds: list[float], e: float, wall: bool) -> tuple[str, bool]:
    """Beads of length 1 on a line."""
    sim = bench.simulate(
        dimension=1,
        time={"step": 0.01, "steps": 500},
        particles=[{"position": [[x] for x in beads], "velocity": [[v] for v in speeds], "radius": 0.5}],
        effects={
            "collisions": {"restitution": e},
            **({"walls": {"planes": [{"point": [0.0], "normal": [1.0]}], "restitution": e}} if wall else {}),
        },
    )
    start = before = sim.measure()["kinetic"]
    risen, lowest = -np.inf, np.inf
    for _ in range(500):
        sim.step()
        energy = sim.measure()["kinetic"]
        risen, before = max(risen, (energy - before) / start), energy
        lowest = min(lowest, float(np.diff(everyone(sim).position[:, 0]).min()))
    events = int(sim.ranks.allreduce_sum(sim.totals["collisions"])[0])
    missed = int(sim.ranks.allreduce_sum(sim.totals["missed"])[0])
    holds = risen <= 1e-14 and np.isfinite(before) and (lowest >= 1.0 - 1e-9 or missed > 0)
    return f"{events} contacts, {missed} missed, energy at most {risen:+.0e} a step, closest {lowest:.9f}", bool(holds)


NEVER_ENDS = "infinitely many contacts: the clock stops"
GOES_ON = "the clock advances, energy never rises"


@case("inelastic collapse: 3 beads, e = 0.065", NEVER_ENDS, GOES_ON, dimensions=(1,))
def three_beads(bench: Bench) -> tuple[str, bool]:
    return collapse(bench, [0.0, 1.5, 3.0], [1.0, 0.0, -1.0], 0.065, False)


@case("inelastic collapse: 4 beads, e = 0.15", NEVER_ENDS, GOES_ON, dimensions=(1,))
def four_beads(bench: Bench) -> tuple[str, bool]:
    return collapse(bench, [0.0, 1.3, 2.6, 4.0], [1.0, 0.3, -0.3, -1.0], 0.15, False)


@case("inelastic collapse: 2 beads and a wall, e = 0.1", NEVER_ENDS, GOES_ON, dimensions=(1,))
def wall_and_two(bench: Bench) -> tuple[str, bool]:
    return collapse(bench, [0.7, 2.0], [-1.0, -1.5], 0.1, True)


@case(
    "dense fluid at packing 0.55",
    "particles lost, overlaps that grow",
    "none lost, no overlap, Z = 11.52 +- 2 % (fcc crystal)",
    dimensions=(3,),
)
def dense_fluid(bench: Bench) -> tuple[str, bool]:
    """500 spheres from a face-centred lattice, where they stay at this packing.

    Z of the crystal: R. J. Speedy, J. Phys.: Condens. Matter 10, 4387 (1998), 3/(1-z) - 0.5921 (z-0.7072)/(z-0.601) with
    z = packing/0.7405.
    """
    side = (500 * np.pi / 6.0 / 0.55) ** (1.0 / 3.0)
    sim = bench.simulate(
        box={"lower": [0.0] * 3, "upper": [float(side)] * 3, "periodic": True},
        seed=4,
        time={"step": 0.002, "steps": 400},
        particles=[{"count": 500, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5}],
        effects={"collisions": {"passes": 20} if bench.mode == "rewind" else {}},
        output={"observables": True},
    )
    for _ in range(100):
        sim.step()
    sim.measure()
    for _ in range(300):
        sim.step()
    row, p = sim.measure(), everyone(sim)
    r = p.position[:, None] - p.position[None]
    r -= image_shifts(r, side)
    closest = np.sqrt((r**2).sum(axis=2))[np.triu_indices(500, 1)].min()
    z = row["z_virial"]
    missed = int(sim.ranks.allreduce_sum(sim.totals["missed"])[0])
    holds = len(p) == 500 and closest >= 1.0 - 1e-9 and missed == 0 and abs(z / 11.515 - 1.0) < 0.02
    return f"Z {z:.2f}, closest {closest:.6f} diameters, {missed} missed", bool(holds)
