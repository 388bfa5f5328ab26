"""Compile all kernels once, so that no run has to wait for it: `mpirun -n 2 python -m particles_mpi.setup.warmup`.

Very small scenes are run which together use every kernel with every combination of types, in 1, 2 and 3 dimensions, on one rank
and on two. The test suite fails at its end if a test has compiled something that these scenes had not: add a scene here then.
"""

import shutil
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from particles_mpi.contacts.event_driven.messages import message_of
from particles_mpi.contacts.event_driven.operator import EventDriven
from particles_mpi.initial.populate import populate
from particles_mpi.initial.random_addition import FEW_LEFT
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.scene.schema import Scene
from particles_mpi.setup.kernel_sources import PACKAGE, Sources
from particles_mpi.simulation import Simulation
from particles_mpi.source_files import edited

DIMENSIONS = (3, 2, 1)
LOSSY = {"restitution": 0.5}
EDGE = 4.0  # length of the box
NO_PART = 4  # a kind of part that no message has


def scene(d: int, effects: dict[str, Any], *, periodic: bool = False, **more: Any) -> Scene:
    """A few particles that meet one another, walls and periodic faces within two steps; one of them lies on the floor."""
    some = {"radius": 0.2, "mass": 1.0}
    lying = {"position": [[2.0] * (d - 1) + [0.2]], **some}
    flying = {"count": 4, "position": "random", "velocity": {"speed": 10.0}, **some}
    box = {"lower": [0.0] * d, "upper": [EDGE] * d, "periodic": periodic}
    time = {"step": 0.01, "steps": 2} | more.pop("time", {})
    return Scene(dimension=d, time=time, effects=effects, **({"box": box, "particles": [lying, flying]} | more))


def simulate(ranks: Communicator, the_scene: Scene) -> Simulation:
    """A simulation; with pairs, one that computes each step for itself, as for more spheres."""
    sim = Simulation(the_scene, ranks.comm)
    if sim.active.pairs:
        sim.many_steps = None
    return sim


def run(ranks: Communicator, d: int, effects: dict[str, Any], **more: Any) -> None:
    """Compute all that a run of such a scene computes: steps, the watchdog, diagnostics."""
    sim = simulate(ranks, scene(d, effects, **more))
    if isinstance(sim.near, EventDriven) and ranks.size > 1:  # windows of time on divided space, however few particles there are
        sim.near.divided = sim.near.windows.always = True
    sim.run()
    if sim.many_steps:  # what more particles need
        sim.many_steps = None
        sim.step()
    sim.measure()
    if sim.persistent and sim.persistent.pairs:
        sim.persistent.slow.effort = 0  # as in a large pile
        sim.persistent.keep_crowds(sim.rows, sim.sum_forces(), sim.h, 0)


def down(d: int) -> dict[str, Any]:
    """Options of a uniform gravity along the last axis."""
    return {"acceleration": [0.0] * (d - 1) + [-1.0]}


def struck_row(d: int, count: int) -> list[dict[str, Any]]:
    """A row of `count` spheres that touch, across the middle of the box, and one that hits it."""
    aside, radius = [0.5 * EDGE] * (d - 1), 1.5 / (count + 2.5)
    end = 0.5 * EDGE + radius * count
    return [
        {"position": [[end - 2.0 * radius * (k + 0.5), *aside] for k in range(count)], "radius": radius},
        {"position": [[end + 1.1 * radius, *aside]], "velocity": [-10.0] + [0.0] * (d - 1), "radius": radius},
    ]


def event(d: int, ranks: Communicator) -> None:
    """Mode event: one collision by itself, a periodic box, several ranks."""
    collisions = {"mode": "event"}
    if ranks.size == 1:
        Simulation(scene(d, {"collisions": collisions}), ranks.comm).step_to_collision()
        flock = [{"count": 100, "position": "lattice", "velocity": [9.0] * d, "radius": 0.01}]  # all leave their skins at once
        run(ranks, d, {"collisions": collisions}, periodic=True, particles=flock, time={"step": 0.05, "steps": 12})
    else:
        losses(d, ranks)


def losses(d: int, ranks: Communicator) -> None:
    """Mode event where spheres come to rest, one on another of very different mass."""
    lossy = {"collisions": LOSSY | {"mode": "event"}, "walls": LOSSY, "uniform_gravity": down(d)}
    heavy = [{"position": [[2.0] * (d - 1) + [0.2 + 0.4 * k] for k in range(2)], "radius": 0.2, "mass": [1.0, 1e8]}]
    run(ranks, d, lossy, particles=heavy)


def rewind(d: int, ranks: Communicator) -> None:
    """Mode rewind: with and without walls, losses, forces and a periodic box."""
    lossy: dict[str, Any] = {"collisions": LOSSY, "walls": LOSSY}
    run(ranks, d, {"collisions": {}, "drag": {"rate": 0.1}}, periodic=True)
    run(ranks, d, {"uniform_gravity": down(d), "friction": {"strength": 0.1}} | lossy)
    run(ranks, d, {"mutual_gravity": {}, "collisions": {}, "walls": {}})
    crowd = [{"count": 2, "position": [[1.0] * d, [1.1] * d], "radius": 0.3}, {"position": [[2.0] * d], "radius": 0.3}]
    run(ranks, d, {"collisions": {"allow_overlap": True}, "walls": {}}, particles=crowd)
    lasting = {"uniform_gravity": down(d), "collisions": {"restitution": 0.9}}
    for count in (2, 7):  # settled after two passes; not settled after three, so that the operator `event` takes over
        run(ranks, d, lasting, particles=struck_row(d, count), time={"step": 0.03})
    bouncing = [{"position": [[2.0] * d], "velocity": [50.0] + [0.0] * (d - 1), "radius": 1.9}]  # off more walls than passes
    run(ranks, d, {"collisions": {"passes": 1}, "walls": {}}, particles=bouncing)


def rough(d: int, ranks: Communicator) -> None:
    """Rough spheres, which come to rest; on walls alone too; and a column of them that is solved as a large pile."""
    surfaces = LOSSY | {"friction": 0.3, "tangential_restitution": 0.5}
    more = {"uniform_gravity": down(d), "rolling": {"resistance": 0.01}, "walls": surfaces}
    run(ranks, d, more | {"collisions": surfaces}, output={"orientation": True})
    run(ranks, d, more)
    column = [{"position": [[2.0] * (d - 1) + [0.2 + 0.4 * k] for k in range(3)], "radius": 0.2}]
    sim = Simulation(scene(d, more | {"collisions": surfaces}, particles=column), ranks.comm)
    sim.persistent.slow.effort = 0
    sim.step()


def others(d: int, ranks: Communicator) -> None:
    """Scenes without pairs: walls alone, integrators, the direct sum; and two spheres that fly past one another."""
    run(ranks, d, {"uniform_gravity": down(d), "walls": LOSSY})
    for integrator in ("taylor", "leapfrog", "order4", "adaptive"):
        run(ranks, d, {"uniform_gravity": down(d), "mutual_gravity": {"softening": 0.1}}, time={"integrator": integrator})
    many = [{"count": 300, "position": "random"}]
    run(ranks, d, {"mutual_gravity": {"softening": 0.1}}, particles=many)
    apart = [{"position": [[1.0] * d, [3.0] * d], "radius": 0.1}]
    Simulation(scene(d, {"collisions": {}}, particles=apart), ranks.comm).steps(2)


def windows(d: int, ranks: Communicator) -> None:
    """The messages between ranks in mode event, most of them the same in all dimensions: one rank sends them to itself."""
    sim = simulate(ranks, scene(d, {"collisions": {"mode": "event"}}))
    assert isinstance(sim.near, EventDriven)
    divided, part = sim.near.windows, sim.near.windows.partition
    sim.near.divided = divided.always = True
    sim.step()
    part.neighbours = [0]
    part.send_motion()
    part.changes_for(0, part.plan_moves())
    divided.undo(divided.engine.work.counts)
    nothing = message_of(np.array([NO_PART, 0]).view(float))
    divided.accept(nothing, np.empty((0, 2), np.int64), part.plan_moves())


def starts(ranks: Communicator) -> None:
    """Random places of so many spheres that ranks throw them apart from one another."""
    many = [{"count": FEW_LEFT + 1000, "position": "random", "radius": 0.001}]
    populate(scene(3, {"collisions": {}, "walls": {}}, particles=many), ranks)


def tree(ranks: Communicator) -> None:
    """The tree, the same in all dimensions; with enough particles for far cells."""
    many = [{"count": 300, "position": "random"}]
    for multipole in ("quadrupole", "monopole"):
        run(ranks, 3, {"mutual_gravity": {"method": "tree", "multipole": multipole}}, particles=many)


def orbits(ranks: Communicator) -> None:
    """The kernel of the study."""
    from particles_mpi.study.hard_cases.orbits import circle

    circle(1, 4, False)


# Each for one rank: those that take longest first, in an order in which neighbours share few kernels. Mode `rewind` needs the
# kernels of mode `event` too, one of which takes longer to compile than any other.
JOBS: tuple[Callable[[Communicator], None], ...] = (
    starts,
    partial(event, 3),
    partial(event, 2),
    tree,
    partial(event, 1),
    partial(rewind, 3),
    partial(windows, 3),
    partial(others, 2),
    orbits,
    partial(others, 3),
    partial(windows, 2),
    partial(rewind, 2),
    partial(others, 1),
    partial(windows, 1),
    partial(rewind, 1),
    *(partial(losses, d) for d in DIMENSIONS),
    partial(rough, 3),
    partial(rough, 2),
)


def main() -> None:
    """Each rank takes the next job that no other has taken; then all ranks run those of several ranks together."""
    begin = perf_counter()
    world, alone = Communicator(), Communicator.alone()
    claims = Path(world.bcast(tempfile.mkdtemp() if world.is_root else None))
    claims.mkdir(parents=True, exist_ok=True)  # on another machine
    for number, job in enumerate(JOBS):
        try:
            (claims / str(number)).mkdir()
        except FileExistsError:
            continue
        job(alone)
    world.sleeping_barrier()
    for d in DIMENSIONS:
        event(d, world)
        rewind(d, world)
        others(d, world)
    for d in (3, 2):
        rough(d, world)
    tree(world)
    starts(world)
    if world.is_root:
        shutil.rmtree(claims)
        if edited():
            sys.exit("sources were edited meanwhile: kernels compiled since then are not kept")
        Sources(PACKAGE).note()
        print(f"kernels compiled in {perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
