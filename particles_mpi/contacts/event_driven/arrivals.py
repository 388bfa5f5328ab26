"""Compiled parts of `windows`: how a rank handles the messages after a window of time. `messages` describes what they hold."""

import numpy as np

from particles_mpi.contacts.event_driven.calendar_queue import Queue, cancel
from particles_mpi.contacts.event_driven.id_table import drop, home, put, row_of
from particles_mpi.contacts.event_driven.messages import (
    ADD_GHOST,
    DROP_GHOST,
    HEAD,
    HOLDER,
    PLACE,
    TRANSFER,
    UPDATE,
    Directory,
    add_holder,
    extra_width,
    load_extra,
    ownership,
    part_width,
)
from particles_mpi.contacts.event_driven.regions import Moves, Regions, can_affect_owned, mark_holders
from particles_mpi.contacts.event_driven.rows import (
    EVENT_COUNT,
    GHOST,
    ID,
    NOT_HERE,
    OWNERSHIP,
    SHARED,
    TRAJECTORY_HASH,
    Log,
    Rows,
    dimension,
    has_new_segment,
    hash_place,
    load_row,
    record_width,
    spin_width,
)
from particles_mpi.kernels.jit import inner, kernel, lean, lean_inner, prefetch
from particles_mpi.kernels.markers import RADIUS
from particles_mpi.neighbours.verlet_cells import level_of
from particles_mpi.neighbours.verlet_kernels import (
    INVERSE_MASS,
    SIZE,
    SKIN,
    Lists,
    compare,
    find_nearby,
    relist,
    remove,
    shortage,
)


@lean
def roll_back(rows, log, stale):
    """Set all rows back to the start of the window. Returns how many, written to `stale`, must find their next events again."""
    rows, log = Rows(*rows), Log(*log)
    d, record = dimension(rows), record_width(dimension(rows), spin_width(rows))
    for p in range(log.changed_count[0]):
        load_row(d, rows, np.int64(log.changed[p]), log.saved, log.saved_bits, p * record)
        stale[p] = log.changed[p]
    return log.changed_count[0]


@kernel
def verify(rows, lists, directory, log, regions, begin, message):
    """Return (must the window that began at `begin` be undone, which ghosts differ from their owners' rows).

    It must if a ghost that differs could have touched an own row. `message`: all that arrived; a ghost without an UPDATE in it
    did not change at its owner. For each ghost that differs, (m, 2): its row, and the place of its right record in the message;
    or, if that is in `log.saved`, len(numbers) plus its place there.
    """
    rows, lists, directory, log, regions = Rows(*rows), Lists(*lists), Directory(*directory), Log(*log), Regions(*regions)
    numbers, bits = message
    state, table, updated = rows.state, directory.table, directory.updated
    d, extra, window = regions.low.shape[1], extra_width(rows), log.window[0]
    record = record_width(d, spin_width(rows))
    differing, found = np.empty((len(numbers) // (HEAD + record) + log.border_count[0], 2), np.int64), 0
    place = np.empty((2, d))
    wrong = False
    for step in range(2):  # first to the cache
        at = 0
        while at < len(numbers):
            if bits[at] == UPDATE:
                if step == 0:
                    prefetch(table, home(table, bits[at + 1]))
                else:
                    i = row_of(table, bits[at + 1])
                    prefetch(state, i)
                    prefetch(updated, i)
            at += part_width(bits[at], d, record, extra)
    at = 0
    while at < len(numbers):
        if bits[at] == UPDATE:
            i = row_of(table, bits[at + 1])
            updated[i] = window
            if bits[at + HEAD + hash_place(d)] != state[i, TRAJECTORY_HASH]:
                wrong = wrong or can_affect_owned(rows, lists, log, regions, i, begin, place)
                differing[found, 0], differing[found, 1] = i, at + HEAD
                found += 1
        at += part_width(bits[at], d, record, extra)
    for p in log.border[: log.border_count[0]]:
        i = np.int64(log.changed[p])
        if state[i, OWNERSHIP] == GHOST and updated[i] != window and has_new_segment(d, rows, log, p):
            wrong = wrong or can_affect_owned(rows, lists, log, regions, i, begin, place)
            differing[found, 0], differing[found, 1] = i, len(numbers) + p * record
            found += 1
    return wrong, differing[:found]


@lean
def reconcile(rows, directory, log, message, differing, moves, regions, stale):
    """After a correct window: ghosts that differ from their owners' rows become equal to them, and moved rows change owner.

    Returns how many rows, written to `stale`, must find their next events again.
    """
    rows, directory, log, moves = Rows(*rows), Directory(*directory), Log(*log), Moves(*moves)
    numbers, bits = message
    rank, here = Regions(*regions).rank, len(Regions(*regions).known) - 1
    d, state, masks = dimension(rows), rows.state, directory.holders.shape[1]
    for p in range(len(differing)):
        i, at = differing[p, 0], differing[p, 1]
        if at < len(numbers):
            load_row(d, rows, i, numbers, bits, at)
        else:
            load_row(d, rows, i, log.saved, log.saved_bits, at - len(numbers))
        stale[p] = i
    for m in range(log.moved_count[0]):
        i = np.int64(log.moved[m])
        log.is_moved[i] = False
        for b in range(masks):
            directory.holders[i, b] = moves.holders[m, b]
        state[i, OWNERSHIP] = ownership(directory.holders, i, here) if moves.owner[m] == rank else GHOST
    log.moved_count[0] = 0
    return len(differing)


@inner
def list_at(axes, rows, lists, directory, message, at, record, skin):
    """Give the row of an ADD_GHOST, which is new here, or of a TRANSFER, a new list at its reference position.

    Returns (row, 0), or, as `apply_moves`, by how much there is too little room; then nothing has changed.
    """
    numbers, bits = message
    d, reference, segment = len(axes), lists.reference, rows.segment
    particle, new = bits[at + 1], bits[at] == ADD_GHOST
    if new:
        if directory.free_count[0] == 0:
            return -1, -1
        i = np.int64(directory.free[directory.free_count[0] - 1])
        size = at + HEAD + record  # where R and 1/m are, and behind them the reference position
        segment[i, 2 * d + RADIUS], reference[i, d + INVERSE_MASS] = numbers[size], numbers[size + 1]
        place = size + 2
    else:
        i = row_of(directory.table, particle)
        place = at + HEAD + 3
    before = reference[i].copy()
    for k in range(d):
        reference[i, k] = numbers[place + k]
    if new:
        reference[i, d + SKIN] = skin if reference[i, d + INVERSE_MASS] > 0.0 else 0.0
        reference[i, d + SIZE] = segment[i, 2 * d + RADIUS] + reference[i, d + SKIN]
    found = find_nearby(axes, lists, i)
    kept, others = compare(lists, i, found)
    short = shortage(lists, i, kept, others)
    if short > 0:
        for k in range(d + INVERSE_MASS + 1):
            reference[i, k] = before[k]
        return i, short
    if new:
        directory.free_count[0] -= 1
        put(directory.table, particle, i)
        rows.state[i, ID], rows.state[i, OWNERSHIP] = particle, GHOST
        load_row(d, rows, i, numbers, bits, at + HEAD)
        load_extra(d, rows, i, numbers, place + d)
        lists.level[i] = level_of(reference[i, d + SIZE], lists)
    relist(axes, lists, i, kept, others)
    return i, 0


@inner
def take_over(rows, lists, directory, regions, message, at, i):
    """Make row i an own one, as the TRANSFER at this place says; which ranks hold it is found by the sender's rule."""
    _, bits = message
    holders, known, at_row = directory.holders, Regions(*regions).known, np.full(1, i, np.int32)
    holder, place, before = bits[at + HEAD], bits[at + HEAD + 1], bits[at + HEAD + 2]
    directory.fields_at[i, HOLDER], directory.fields_at[i, PLACE] = holder, place
    mark_holders(lists.reference, at_row, regions, holders[i : i + 1])
    for k in range(len(known)):
        if known[k] == before:
            add_holder(holders, i, k)
    add_holder(holders, i, len(known) - 1)
    rows.state[i, OWNERSHIP] = SHARED  # the rank that had it holds it, at least


@lean_inner
def drop_ghost(axes, rows, lists, queue, directory, particle):
    """Free the row of a particle that has left the neighbourhood of this rank's region."""
    i = row_of(directory.table, particle)
    cancel(queue, i)
    remove(axes, lists, i)
    rows.state[i, OWNERSHIP] = NOT_HERE
    rows.state[i, EVENT_COUNT] += 1
    drop(directory.table, particle)
    directory.free[directory.free_count[0]] = i
    directory.free_count[0] += 1


@kernel
def apply_moves(axes, rows, lists, queue, directory, regions, message, at, skin, stale, pending):
    """Apply the parts ADD_GHOST, TRANSFER and DROP_GHOST of a message, from place `at` on.

    stale[:pending[0]]: rows that must find their next events. Returns (place, shortage): the end and 0; or the place of a part
    for which the pool of the lists is too small by so many places, or for which there is no free row (-1): then enlarge and call
    again from there.
    """
    rows, lists, queue, directory = Rows(*rows), Lists(*lists), Queue(*queue), Directory(*directory)
    numbers, bits = message
    extra, record = extra_width(rows), record_width(len(axes), spin_width(rows))
    while at < len(numbers):
        kind, particle = bits[at], bits[at + 1]
        if kind == DROP_GHOST:
            drop_ghost(axes, rows, lists, queue, directory, particle)
        elif kind == TRANSFER or (kind == ADD_GHOST and row_of(directory.table, particle) < 0):
            i, short = list_at(axes, rows, lists, directory, message, at, record, skin)
            if short != 0:
                return at, short
            stale[pending[0]] = i
            pending[0] += 1
            if kind == TRANSFER:
                take_over(rows, lists, directory, regions, message, at, i)
        at += part_width(kind, len(axes), record, extra)
    return at, 0
