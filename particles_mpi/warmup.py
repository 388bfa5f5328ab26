"""Compile the kernels once, so that a first run does not wait for it: `mpirun -n 2 python -m particles_mpi.warmup`."""

from __future__ import annotations

from time import perf_counter

from particles_mpi.collide.event import Event
from particles_mpi.parallel.ranks import Ranks
from particles_mpi.scene import Scene
from particles_mpi.simulation import Simulation

DIMENSIONS = (3, 2)


def tiny(dimension: int, periodic: bool, effects: dict[str, object], integrator: str = "leapfrog") -> Scene:
    """A few particles that meet one another, walls and periodic faces within two steps; one lies on the floor."""
    d = dimension
    acceleration = [0.0] * (d - 1) + [-1.0]
    available = {"uniform_gravity": {"acceleration": acceleration}, "walls": {}, "collisions": {}, "mutual_gravity": {}}
    return Scene(
        dimension=d,
        box={"lower": [0.0] * d, "upper": [4.0] * d, "periodic": periodic},
        time={"step": 0.01, "steps": 2, "integrator": integrator},
        particles=[
            {"position": [[2.0] * (d - 1) + [0.2]], "radius": 0.2, "mass": 1.0},
            {"count": 4, "position": "random", "velocity": {"speed": 10.0}, "radius": 0.2, "mass": 1.0},
        ],
        effects={name: keys or available[name] for name, keys in effects.items()},
    )


def main() -> None:
    """Every kernel in two and three dimensions: a dimension a rank, then those of ghosts, together."""
    begin = perf_counter()
    world, alone = Ranks(), Ranks.alone()
    lossy: dict[str, object] = {"walls": {"restitution": 0.5}, "collisions": {"restitution": 0.5}}
    for ranks, dimensions in ((alone, DIMENSIONS[world.rank :: world.size]), (world, DIMENSIONS)):
        for d in dimensions:
            scenes = [
                tiny(d, False, {"uniform_gravity": None, "friction": {"strength": 0.1}} | lossy),
                tiny(d, False, {"mutual_gravity": None} | lossy),
                tiny(d, True, {"collisions": None, "drag": {"rate": 0.1}}),
                tiny(d, False, {"uniform_gravity": None, "walls": None}),
                *[tiny(d, p, {"collisions": {"mode": "event"}, "walls": None}) for p in (False, True)],
                tiny(d, False, {"uniform_gravity": None, "mutual_gravity": None}),
                *[tiny(d, False, {"mutual_gravity": {"method": "tree", "multipole": m}}) for m in ("quadrupole", "monopole")],
            ]
            for scene in scenes:
                sim = Simulation(scene, ranks.comm)
                if ranks is world and isinstance(sim.near, Event):
                    sim.near.divided = sim.near.windows.always = ranks.size > 1
                sim.run()
                sim.measure()
                if sim.rest and sim.rest.pairs:
                    sim.rest.hold(sim.rows, sim.sum_forces(), sim.h)
    if world.is_root:
        print(f"kernels compiled in {perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
