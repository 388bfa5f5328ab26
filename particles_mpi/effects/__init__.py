"""What acts on the particles: one file for each effect. A new effect is one new file and needs no other edit.

The file is `effects/NAME.py` in this package, or a user's file that the scene names, with a path relative to the scene file:

    [effects.magnetic_field]
    file = "magnetic.py"
    strength = [0.0, 0.0, 2.0]

It defines two classes, `Options` and `Effect`. `Options(EffectOptions)` has one field for each key of the scene's table and
checks them. `Effect` derives from one of these kinds, which determine when it acts:

- `Force`: `add` adds to the acceleration of each particle, given the positions;
- `VelocityFlow`: `advance` changes velocities at fixed positions, exactly, for instance by a rotation in a magnetic field;
- `Event`: `act` changes positions and velocities at the end of the drift of each step.

All three change arrays in place. `add` and `advance` return nothing, `act` returns how many particles it has changed. Changes
to the velocities of fixed particles are undone. `fixed` is an array of 0 and 1 there, so the mask of rows is `fixed != 0`. A
force can only read the built-in fields, a flow not change positions, none of them ids: these arrays are read-only, so write a
kernel without an explicit signature. Flows and events need the integrator `leapfrog` or `taylor`. A file that was edited is
read again by the next scene; simulations that exist already keep the old version.

`needs` declares what an effect needs from the program. A column of its own per particle (a charge, say) becomes a key of every
`[[particles]]` table, and is written to frames and checkpoints. An effect that no scene names is never imported.

The code of an effect must follow some rules:

- Results must have the same bits on any number of ranks. So decide by data and ids of particles, never by the order of rows.
  Write products of vectors out, or take sums along an axis: `positions @ matrix` has other bits for one row than for many.
- Each rank calls the methods for its own rows, and may have none. `kernel` compiles a function with a loop over rows.
- An `Effect` is built several times, also before a run. What takes long, such as reading a table, belongs in `bind`, which is
  called when a simulation begins.
- Keep no data in the object from one step to the next: a simulation that is copied or resumed builds it again. Such data belongs
  in a column.
- An effect does not know the time. A script may change an option between two steps (`sim.effects["wind"].strength = ...`).
- When a run is resumed, the program checks that the file is the same, but not the modules that it imports.

A force with a `potential` is part of the total energy. Each partner of a pair gets half of the pair's energy, whether it is fixed
or not. The energy of a fixed particle counts too, as a constant, unless it is not finite. In a periodic box a potential must have
the same value where a particle leaves the box and where it enters again. A force that drives particles around the box has none:
`potential` then returns `nan` for each particle.

A force between particles needs those of other ranks. Before the first step, `bind` gets the `Context` with the ranks and the box.
Set `collective = True` if `add` exchanges messages: all ranks then call it together, with rows or without. Examples are in
`tests/parallel/outside`: `springs.py`, a force; `repulsion.py`, a force between pairs; `magnetic.py`, a velocity flow; `gate.py`,
an event.

The other kinds, `Damping`, `ConstantFriction`, `RollingResistance`, `WallContacts` and `PairContacts`, are for the program's own
effects: there is one of each, and they are computed together.
"""

from particles_mpi.kernels.jit import kernel
from particles_mpi.particles import Array, Column, Particles
from particles_mpi.scene.effect import Context, EffectOptions, Event, Force, Needs, VelocityFlow
from particles_mpi.scene.schema import Scene

__all__ = [
    "Array",
    "Column",
    "Context",
    "EffectOptions",
    "Event",
    "Force",
    "Needs",
    "Particles",
    "Scene",
    "VelocityFlow",
    "kernel",
]
