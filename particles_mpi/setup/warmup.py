"""Compile all kernels once, so that no run has to wait for it: `mpirun -n 2 python -m particles_mpi.setup.warmup`.

Very small scenes are run which together use every kernel with every combination of types, in 1, 2 and 3 dimensions, on one rank
and on two. The test suite fails at its end if a test has compiled something that these scenes had not: then a scene has to
be added here, usually with a new effect, operator or kernel.
"""

import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from particles_mpi.contacts.event_driven.messages import message_of
from particles_mpi.contacts.event_driven.operator import Event
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.scene.schema import Scene
from particles_mpi.setup.kernel_sources import PACKAGE, Sources
from particles_mpi.simulation import Simulation

DIMENSIONS = (3, 2, 1)
LOSSY = {"restitution": 0.5}
EDGE = 4.0  # length of the box
NO_PART = 4  # a kind of part that no message has

Job = Callable[[Communicator], None]


def scene(d: int, effects: dict[str, Any], *, periodic: bool = False, **more: Any) -> Scene:
    """A few particles that meet one another, walls and periodic faces within two steps; one of them lies on the floor."""
    some = {"radius": 0.2, "mass": 1.0}
    tables: dict[str, Any] = {
        "box": {"lower": [0.0] * d, "upper": [EDGE] * d, "periodic": periodic},
        "particles": [
            {"position": [[2.0] * (d - 1) + [0.2]], **some},
            {"count": 4, "position": "random", "velocity": {"speed": 10.0}, **some},
        ],
    }
    tables |= more
    time = {"step": 0.01, "steps": 2} | tables.pop("time", {})
    return Scene(dimension=d, time=time, effects=effects, **tables)


def run(described: Scene, ranks: Communicator) -> Simulation:
    """Compute all that a run computes: steps, the watchdog, diagnostics."""
    sim = Simulation(described, ranks.comm)
    if isinstance(sim.near, Event) and ranks.size > 1:  # windows of time on divided space, however few particles there are
        sim.near.divided = sim.near.windows.always = True
    sim.run()
    sim.measure()
    if sim.rest and sim.rest.pairs:
        sim.rest.hold(sim.rows, sim.sum_forces(), sim.h)
    return sim


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
    """Mode event: with and without walls, a periodic box, observables."""
    collisions: dict[str, Any] = {"mode": "event"}
    run(scene(d, {"collisions": collisions, "walls": {}}, output={"observables": True}), ranks)
    run(scene(d, {"collisions": collisions}, periodic=True), ranks)
    if ranks.size == 1:
        Simulation(scene(d, {"collisions": collisions}), ranks.comm).step_to_collision()
    else:  # particles that change their rank, and windows that have to be undone
        gas = [{"count": 8 * d, "position": "random", "velocity": {"speed": 10.0}, "radius": 0.05}]
        run(scene(d, {"collisions": collisions}, periodic=True, particles=gas, time={"step": 0.05, "steps": 12}), ranks)
        run(scene(d, {"collisions": collisions}, particles=struck_row(d, 12), time={"step": 0.05}), ranks)
        losses(d, ranks)


def losses(d: int, ranks: Communicator) -> None:
    """Mode event where spheres come to rest."""
    lossy: dict[str, Any] = {"collisions": LOSSY | {"mode": "event"}, "walls": LOSSY, "uniform_gravity": down(d)}
    run(scene(d, lossy), ranks)


def rewind(d: int, ranks: Communicator) -> None:
    """Mode rewind: with and without walls, losses, forces and a periodic box."""
    lossy: dict[str, Any] = {"collisions": LOSSY, "walls": LOSSY}
    run(scene(d, {"collisions": {}, "walls": {}}, output={"observables": True}), ranks)
    run(scene(d, {"collisions": {}, "drag": {"rate": 0.1}}, periodic=True), ranks)
    run(scene(d, {"uniform_gravity": down(d), "friction": {"strength": 0.1}} | lossy), ranks)
    run(scene(d, {"mutual_gravity": {}} | lossy), ranks)
    crowd = [{"count": 2, "position": [[1.0] * d, [1.1] * d], "radius": 0.3}, {"position": [[2.0] * d], "radius": 0.3}]
    run(scene(d, {"collisions": {"allow_overlap": True}, "walls": {}}, particles=crowd), ranks)
    lasting = {"uniform_gravity": down(d), "collisions": {"restitution": 0.9}}
    for count in (2, 7):  # settled after two passes; not settled after three, so that the operator `event` takes over
        run(scene(d, lasting, particles=struck_row(d, count), time={"step": 0.03}), ranks)
    bouncing = [{"position": [[2.0] * d], "velocity": [50.0] + [0.0] * (d - 1), "radius": 1.9}]  # off more walls than passes
    run(scene(d, {"collisions": {"passes": 1}, "walls": {}}, particles=bouncing), ranks)
    few = {"passes": 1} | LOSSY
    run(scene(d, {"collisions": few, "walls": {}, "uniform_gravity": down(d)}, time={"step": 0.03}), ranks)


def others(d: int, ranks: Communicator) -> None:
    """Scenes without pairs: walls alone, integrators, the direct sum."""
    run(scene(d, {"uniform_gravity": down(d), "walls": LOSSY}), ranks)
    run(scene(d, {"walls": {}}), ranks)
    for integrator in ("taylor", "leapfrog", "order4", "adaptive"):
        run(scene(d, {"uniform_gravity": down(d), "mutual_gravity": {}}, time={"integrator": integrator}), ranks)
    run(scene(d, {"drag": {"rate": 0.1}}, periodic=True), ranks)
    run(scene(d, {"friction": {"strength": 0.1}}), ranks)
    run(scene(d, {}), ranks)


def windows(ranks: Communicator) -> None:
    """The messages between ranks in mode event, the same in all dimensions: one rank sends them to itself."""
    sim = Simulation(scene(3, {"collisions": {"mode": "event"}}), ranks.comm)
    assert isinstance(sim.near, Event)
    divided = sim.near.windows
    sim.near.divided = divided.always = True
    sim.step()
    divided.near = [0]
    divided.send_motion()
    divided.changes_for(0, divided.plan_moves())
    divided.undo(divided.engine.work.counts)
    nothing = message_of(np.array([NO_PART, 0]).view(float))
    divided.accept(nothing, divided.plan_moves())


def tree(ranks: Communicator) -> None:
    """The tree, the same in all dimensions; with enough particles for far cells."""
    many = [{"count": 300, "position": "random"}]
    for multipole in ("quadrupole", "monopole"):
        run(scene(3, {"mutual_gravity": {"method": "tree", "multipole": multipole}}, particles=many), ranks)


def orbits(ranks: Communicator) -> None:
    """The kernel of the study."""
    from particles_mpi.study.hard_cases.orbits import circle

    circle(1, 4, False)


def jobs() -> Iterator[Job]:
    """Each for one rank: those that take longest first, in an order in which neighbours share few kernels.

    Mode `rewind` needs the kernels of mode `event` too, one of which takes longer to compile than any other.
    """
    yield partial(event, 3)
    yield partial(event, 2)
    yield tree
    yield partial(event, 1)
    yield partial(rewind, 3)
    yield windows
    yield partial(others, 2)
    yield orbits
    yield partial(others, 3)
    yield partial(rewind, 2)
    yield partial(others, 1)
    yield partial(rewind, 1)
    for d in DIMENSIONS:
        yield partial(losses, d)


def main() -> None:
    """Each rank takes the next job that no other has taken; then all ranks run those of several ranks together."""
    begin = perf_counter()
    world, alone = Communicator(), Communicator.alone()
    if world.is_root:
        Sources(PACKAGE).forget_stale()
    claims = Path(world.bcast(tempfile.mkdtemp() if world.is_root else None))
    for number, job in enumerate(jobs()):
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
    tree(world)
    if world.is_root:
        Sources(PACKAGE).note()
        print(f"kernels compiled in {perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
