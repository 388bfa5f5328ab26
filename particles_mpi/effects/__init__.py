"""What acts on the particles: one file an effect. A new effect is one new file and no other edit.

The file is `effects/NAME.py` in this package, or a file of the user's that the scene names, relative to the scene file:

    [effects.magnetic_field]
    file = "magnetic.py"
    strength = [0.0, 0.0, 2.0]

It holds two classes of its own, `Options` and `Effect`. `Options(EffectOptions)` has one field for each key of the scene's
table and checks them. `Effect` derives from one of these kinds, which say when it acts:

- `Force`: `add` adds to the acceleration of each particle, given the positions;
- `VelocityFlow`: `advance` changes velocities at fixed positions, exactly, for instance a rotation in a magnetic field;
- `Event`: `act` acts on positions and velocities at the end of the drift of each step.

All three change arrays in place. `add` and `advance` return nothing, `act` the number of particles that it has changed. What
they do to velocities of fixed particles is taken back; `fixed` is 0 or 1 there, so the mask of rows is `fixed != 0`. A force can
only read the fields of the program: a kernel gets arrays for reading, so give it no signature of your own. Flows and events need
`leapfrog` or `taylor`. A file that was edited is read anew by the next scene; simulations that there are go on with what it was.

What an effect needs stands in `needs`: a column of its own per particle (a charge, say) is then a key of every
`[[particles]]` table, and is written to frames and checkpoints. An effect that no scene names is never imported.
`kernel` compiles a function with a loop over rows. Decide by data and ids of particles, never by the order of rows: results
must have the same bits on any number of ranks. So write products of vectors out, or take sums along an axis: `positions @ matrix`
has other bits for one row than for many. Each rank calls the methods for its own rows, of which there may be none.
An `Effect` is made several times, before a run, too: what takes long, as to read a table, is for `bind`, which is called when a
simulation begins. Keep nothing in the object from one step to the next, for a copy, and a run that is gone on with, make it anew:
what must last belongs into a column. An effect is not told the time; a script may change an option between two steps
(`sim.effects["wind"].strength = ...`). Only the file itself is compared when a run goes on, and not what it imports.

A force with a `potential` is part of the total energy: half of the energy of a pair for each partner, fixed or not. What a fixed
particle has by itself counts too, a constant, unless it is not finite. In a periodic box a potential must be the same where a
particle leaves it and where it comes in again; a force that pushes particles around the box has none, and `potential` then
returns `nan` for each.

A force between particles needs those of other ranks. `bind` gives it the `Context` before the first step: the ranks, the box.
Say `collective = True` if `add` exchanges messages: all ranks then call it together, with rows or without. Examples are in
`tests/parallel/outside`: `springs.py`, a force; `repulsion.py`, one between pairs; `magnetic.py`, a velocity flow; `gate.py`, an
event.

The other kinds, `Damping`, `ConstantFriction`, `RollingResistance`, `WallContacts` and `PairContacts`, are for the program's own
effects, one of each, which are computed together and not one after the other.
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
