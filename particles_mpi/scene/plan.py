"""The plan of a run: what it will do, what it will not do, and advice. `run.forecast` estimates how long the run takes."""

from math import inf, sqrt
from typing import Any

import numpy as np

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Particles, field, row_bytes
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.effect_files import effect_names
from particles_mpi.scene.memory import memory_needed
from particles_mpi.scene.schema import Scene

CHECKPOINT_BYTES, HDF5_BYTES, VTK_BYTES, ROW_BYTES = 14_000, 200_000, 1_000, 150  # besides the columns: in files, frames and rows


def plan(scene: Scene, particles: Particles, ranks: Communicator, steps: int) -> dict[str, Any]:
    """Return the plan as plain data, for the screen and for `run.json`. Collective, the same on all ranks.

    `particles`: those of this rank; `steps`: the number of the last step of the run.
    """
    total, fixed = ranks.total(len(particles), np.count_nonzero(particles.fixed))
    runs, active = [], scene.active
    for name, options in active.items():
        effect, how = options.effect_class(), options.described(scene, total)
        runs.append({"effect": name, "role": effect.role, "law": effect.formula} | ({"how": how} if how else {}))
    pairs = "collisions" in active
    ghosts = "particles that may meet those of another rank before the next search"
    if pairs and active["collisions"].mode == "event":
        ghosts = "about three layers of particles around each region, or all particles if that is no more work"
    return {
        "particles": total,
        "fixed": fixed,
        "dimension": scene.dimension,
        "steps": steps,
        "step": scene.time.step,
        "integrator": scene.time.integrator,
        "effects": runs,
        "not_run": sorted({*effect_names(), *scene.effects} - active.keys()),
        "ghosts": ghosts if pairs and ranks.size > 1 else "none",
        "ranks": ranks.size,
        "memory_bytes": memory_needed(scene, particles.arrays, total, ranks.size),
        "frames": (steps // scene.output.every + 1) * bool(scene.output.formats),
        "every": scene.output.every,
        "output_bytes": output_bytes(scene, particles, total * row_bytes(*particles.arrays.values()), total, fixed > 0, steps),
        "predicted_seconds": None,  # of the loop, and between which two: known after the first steps
        "predicted_seconds_range": None,
        "advice": advice(scene, particles, ranks),
    }


def output_bytes(scene: Scene, particles: Particles, state: int, total: int, fixed: bool, steps: int) -> int:
    """Return how large the files of a run get, within some percent; what lasting contacts add to the checkpoint is not known yet.

    `state`: bytes of all columns of all particles; `total`: how many particles there are; `fixed`: are some of them fixed?
    """
    d, output, shown = scene.dimension, scene.output, 0  # bytes of a particle in a frame
    for name, column in particles.arrays.items():
        kind, width = field(name), int(np.prod(column.shape[1:]))
        if kind.output and (fixed or name != "fixed"):
            shown += column.itemsize * (3 + d * (d > 3) if kind.vector else 3 if kind.rotation else width)
    frames, rows, size = steps // output.every + 1, steps // output.diagnostics_every + 1, state + CHECKPOINT_BYTES
    if "hdf5" in output.formats:
        size += frames * total * shown + HDF5_BYTES
    if "vtk" in output.formats:  # with the indices of its cells, in base64
        size += frames * (total * (shown + 24) * 4 // 3 + VTK_BYTES)
    return int(size + rows * ROW_BYTES)


def advice(scene: Scene, particles: Particles, ranks: Communicator) -> list[str]:
    """Return advice about the step, the box and the output, one line for each piece. Collective."""
    h, active, lines = scene.time.step, scene.active, list[str]()
    drag = particles["drag"] if "drag" in particles.arrays else np.empty(0)
    square, smallest = (particles.velocity**2).sum(axis=1), particles.radius[particles.fixed == 0].min(initial=inf)
    largest_square, k, minus_radius = ranks.largest(square.max(initial=0.0), drag.max(initial=0.0), -smallest)
    speed, radius = sqrt(largest_square), -minus_radius  # of the fastest, and of the smallest that moves, if any does
    if "collisions" in active and 0.0 < radius < inf and speed > 0.0:
        share = speed * h / (2.0 * radius)
        crossed, event = f"crosses {share:.2g} of the smallest diameter in a step", active["collisions"].mode == "event"
        lines.append(f"step: the fastest particle {crossed}{' (any number is allowed)' if event else ' (at most 1 is allowed)'}")
        if event:
            lines.append("step: mode event takes about 2 us for each contact, whatever the step: longer steps cost less")
    effects = ActiveEffects(scene)
    if scene.time.integrator == "taylor" and "drag" in active:
        if k * h > 1.0:
            lines.append(f"step: taylor with drag * step = {k * h:.3g} > 1 will oscillate: shorten the step, or use leapfrog")
        lines.append("step: taylor is first order with drag; leapfrog is second order and exact in the velocity")
    elif scene.time.integrator == "taylor" and any(force.place_dependent for force in effects.forces.values()):
        lines.append("step: taylor is first order with forces that depend on position; leapfrog is second order")
    open_axes = np.flatnonzero(np.logical_not(scene.periodic))
    if scene.box and effects.pairs and not effects.walls and len(open_axes):
        axes = " and ".join(map(str, open_axes))
        axes = f"{'axis' if len(open_axes) == 1 else 'axes'} {axes}"
        lines.append(f"box: particles may leave it along {axes}: there is no [effects.walls]")
    if effects.walls and not len(effects.walls.planes.point):
        why = "planes is an empty list" if scene.active["walls"].planes == [] else "the box is periodic along all axes"
        lines.append(f"effects.walls: {why}, so there is no wall")
    if scene.time.integrator == "taylor" and effects.forces and effects.lossy:
        lines.append("step: with taylor particles keep bouncing and never come to rest on anything; with leapfrog they do")
    if scene.dimension > 3:
        lines.append("output.formats: only hdf5 is written, which has all axes of positions and velocities; vtk has three")
    return lines


def duration(seconds: float) -> str:
    """A time in seconds as a text, in a unit that fits its size: "43 s", "2.5 h", "3 days"."""
    if seconds < 10.0:
        return f"{max(seconds, 0.01):.2g} s"
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    if seconds < 7200.0:
        return f"{seconds / 60:.0f} min"
    if seconds < 172_800.0:
        return f"{seconds / 3600:.1f} h"
    days = seconds / 86_400.0
    return f"{days:.0f} days" if days < 730.0 else f"{days / 365.25:.3g} years"
