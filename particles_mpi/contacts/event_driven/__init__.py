"""Mode `event`: all contacts in exact order of time.

The files, in the order in which to read them:

- `rows`: the state of each particle during a drift, above all its path, and the log with which a window of time is undone.
- `segments`: when two rows touch, and how a contact changes them; `neighbours.verlet_kernels` lists the rows that can touch.
- `calendar_queue`: the queue of the next event of each row, which finds the first one of all.
- `jams`: rows that have many contacts without getting anywhere, and rows that have no room to move.
- `next_event`: finds the next event of a row, and its time.
- `event_loop`: the compiled loop that takes one event after the other from the queue.
- `engine`: the rows, lists and queue of a rank as one object.
- `operator`: the class that `Drift` calls: a drift by `Whole` or by `Windows`, repeated where particles crowd together.
- `whole`: the drift where every rank computes all contacts.
- `windows`: the drift where space is divided among ranks, in short windows of time that are verified.
- `partition`: the rows of a rank in that case: its own, and ghosts near them.
- `regions`: which ranks must know a row, and which ghosts can affect own rows.
- `id_table`: a hash table with the row of each id.
- `messages`: what ranks send one another after a window; `arrivals`: what they do with these messages.

The course of one drift: `EventDriven.drift` is called with the length of the step. `Engine.start_drift` puts each particle on a
straight segment, `begin` empties the queue, and `run` calls `event_loop.run`. There, `next_event` finds for each row its first
contact with a row in its list or with a wall, or the time at which the list expires, and `push` puts it into the queue. Then,
again and again, the first event takes place: `hit_row` or `hit_wall` changes velocities, or the row gets a new list; the rows
concerned then look for their next events. At the end `end_drift` moves all rows to the same time, and `write_back` copies them to
the particles. With `Windows`, `run` is called for one window after the other. After each one ranks compare what they found:
`verify` decides whether to `roll_back`, or to `reconcile` the ghosts and `apply_moves` of rows that came, went, or changed owner.
"""
