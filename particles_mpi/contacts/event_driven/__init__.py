"""Mode `event`: all contacts in exact order of time.

The files, in the order in which one reads them:

- `rows`: what a rank knows of each particle during a drift, its path above all, and the log with which a window is undone.
- `segments`: when two rows touch, and what a contact does to them; `neighbours.verlet_kernels` says which rows can touch.
- `calendar_queue`: the next event of each row, and which is the first of all.
- `jams`: what else happens to a row at a contact; rows without room to move, which stand until the end of the drift.
- `next_event`: what each row meets next, and when.
- `event_loop`: the compiled loop that takes one event after the other from the queue.
- `engine`: rows, lists and queue of a rank as one object.
- `operator`: the effect's way in: a drift, by `Whole` or by `Windows`, and once more where particles crowd together.
- `whole`: the drift where every rank computes all contacts.
- `windows`: the drift where space is divided among ranks, in short windows of time that are verified.
- `partition`: which rows a rank has then: its own, and ghosts of those near them.
- `regions`: which ranks must know a row, and which ghosts can affect own rows.
- `id_table`: the row of a particle, by its id; a hash table.
- `messages`: what ranks send one another after a window.
- `arrivals`: what they do with it.

The way of one drift: `EventDriven.drift` is called with the length of the step. `Engine.start_drift` puts each particle on a
straight segment, `begin` empties the queue, and `run` hands everything to `event_loop.run`. There, `next_event` finds for each
row its first contact with a row in its list or with a wall, or the time at which the list expires, and `push` queues it. Then
again and again the first event takes place: `hit_row` or `hit_wall` changes velocities, or the row gets a new list, and the rows
concerned look for their next events. At the end `end_drift` moves all rows to the same time, and `write_back` copies them to the
particles. With `Windows` there are many `run`, and after each one ranks compare what they found: `verify` says whether to
`roll_back`, or to `reconcile` the ghosts and `apply_moves` of those that came, went, or changed owner.
"""
