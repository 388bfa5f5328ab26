"""Many contacts at once: chains, racks, collapse, dense fluids."""

from functools import partial
from itertools import product

import numpy as np

from particles_mpi.kernels.geometry import image_shifts
from particles_mpi.study.experiment import all_particles, total_count
from particles_mpi.study.hard_cases.catalogue import CaseRun, Effects, Finding, case


@case("cradle of 5, column of 50, touching; hit at one end", "several leave, or all move", "the last one leaves, exactly")
def cradle(run: CaseRun) -> Finding:
    """A sphere hits a chain of spheres that touch."""
    off = 0.0
    for n, step in ((5, 0.01), (50, 0.05)):
        chain = {"position": [run.upright(float(k)) for k in range(n)], "radius": 0.5}
        thrown = {"position": [run.upright(-1.33)], "velocity": run.upright(2.0), "radius": 0.5}
        _, p = run.finish([chain, thrown], step, 100, {"collisions": run.in_passes(100)})
        right = np.zeros((n + 1, run.dimension))
        right[n - 1, -1] = 2.0
        off = max(off, float(np.abs(p.velocity - right).max()))
    return f"velocities off {off:.0e}", off == 0.0


@case("rack of 15 touching spheres, broken", "order of the array decides", "energy and momentum to round-off")
def rack(run: CaseRun) -> Finding:
    """A ball breaks a triangle of spheres in a plane."""
    triangle = [run.point(0.75**0.5 * i, j - 0.5 * i) for i in range(5) for j in range(i + 1)]
    cue = {"position": [run.point(-3.0)], "velocity": run.point(4.0), "radius": 0.5}
    sim, _ = run.finish([{"position": triangle, "radius": 0.5}, cue], 0.01, 300, {"collisions": run.in_passes(100)})
    row = sim.measure()
    energy, momentum = abs(row["kinetic"] / 8.0 - 1.0), abs(row["momentum_x"] - 4.0)
    holds = energy <= 1e-14 and momentum <= 1e-14 * 8.0 and total_count(sim, "missed") == 0
    return f"energy off {energy:.0e}, momentum {momentum:.0e}", bool(holds)


@case(
    "a box that spheres fill, thrown in all directions",
    "events for ever, in gaps of round-off",
    "in place, energy kept",
    modes=("event",),
)
def full_box(run: CaseRun) -> Finding:
    """Three spheres in a row along each axis, which touch one another and the walls."""
    places = [[0.2 + 0.4 * k for k in cell] for cell in product(range(3), repeat=run.dimension)]
    speeds = np.random.default_rng(1).standard_normal((len(places), run.dimension)).tolist()
    sim = run.simulate(
        [{"position": places, "velocity": speeds, "radius": 0.2}], 0.01, 20, {"collisions": {}, "walls": {}}, box=run.cube(1.2)
    )
    before = sim.measure()["kinetic"]
    sim.run()
    energy, off = sim.measure()["kinetic"] / before - 1.0, np.abs(all_particles(sim).position - places).max()
    return f"moved {off:.0e}, energy off {energy:+.0e}", bool(off <= 1e-12 and abs(energy) <= 1e-10)


def collapse(run: CaseRun, beads: list[float], speeds: list[float], e: float, wall: bool) -> Finding:
    """Beads of length 1 on a line, between which contacts come ever faster; with a restitution of e."""
    effects: Effects = {"collisions": {"restitution": e}}
    effects |= {"walls": {"planes": [{"point": [0.0], "normal": [1.0]}], "restitution": e}} if wall else {}
    line = {"position": [[x] for x in beads], "velocity": [[v] for v in speeds], "radius": 0.5}
    sim = run.simulate([line], 0.01, 500, effects)
    energies, lowest = [sim.measure()["kinetic"]], np.inf
    for _ in range(500):
        sim.step()
        energies.append(sim.measure()["kinetic"])
        lowest = min(lowest, float(np.diff(all_particles(sim).position[:, 0]).min()))
    risen, events, missed = (np.diff(energies) / energies[0]).max(), total_count(sim, "collisions"), total_count(sim, "missed")
    holds = risen <= 1e-14 and np.isfinite(energies[-1]) and (lowest >= 1.0 - 1e-9 or missed > 0)
    return f"{events} contacts, {missed} missed, energy at most {risen:+.0e} a step, closest {lowest:.9f}", bool(holds)


COLLAPSES = {  # places and speeds of the beads, restitution, is there a wall at 0
    "3 beads, e = 0.065": ([0.0, 1.5, 3.0], [1.0, 0.0, -1.0], 0.065, False),
    "4 beads, e = 0.15": ([0.0, 1.3, 2.6, 4.0], [1.0, 0.3, -0.3, -1.0], 0.15, False),
    "2 beads and a wall, e = 0.1": ([0.7, 2.0], [-1.0, -1.5], 0.1, True),
}
for name, (beads, speeds, e, wall) in COLLAPSES.items():
    function = partial(collapse, beads=beads, speeds=speeds, e=e, wall=wall)
    naive, must = "infinitely many contacts: the clock stops", "the clock advances, energy never rises"
    case(f"inelastic collapse: {name}", naive, must, dimensions=(1,))(function)


@case(
    "dense fluid at packing 0.55",
    "particles lost, overlaps that grow",
    "none lost, no overlap, Z = 11.52 +- 2 % (fcc crystal)",
    dimensions=(3,),
)
def dense_fluid(run: CaseRun) -> Finding:
    """500 spheres from a face-centred lattice, where they stay at this packing.

    Z of the crystal: R. J. Speedy, J. Phys.: Condens. Matter 10, 4387 (1998), 3/(1-z) - 0.5921 (z-0.7072)/(z-0.601) with
    z = packing/0.7405.
    """
    side = (500 * np.pi / 6.0 / 0.55) ** (1.0 / 3.0)
    spheres = {"count": 500, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5}
    box, output = run.cube(float(side)) | {"periodic": True}, {"observables": True}
    sim = run.simulate([spheres], 0.002, 400, {"collisions": run.in_passes(20)}, box=box, output=output, seed=4)
    sim.steps(100)
    sim.measure()
    sim.run()
    row, p = sim.measure(), all_particles(sim)
    r = p.position[:, None] - p.position[None]
    r -= image_shifts(r, side)
    closest = np.sqrt((r**2).sum(axis=2))[np.triu_indices(500, 1)].min()
    z, missed = row["z_virial"], total_count(sim, "missed")
    holds = len(p) == 500 and closest >= 1.0 - 1e-9 and missed == 0 and abs(z / 11.515 - 1.0) < 0.02
    return f"Z {z:.2f}, closest {closest:.6f} diameters, {missed} missed", bool(holds)
