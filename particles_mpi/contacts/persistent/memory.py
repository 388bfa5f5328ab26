"""The impulses of contacts in the last solution, with which the next one begins. They outlast the graph and follow their rows."""

import numpy as np

from particles_mpi.contacts.persistent.graph import ContactGraph
from particles_mpi.contacts.warm_start import Memory
from particles_mpi.kernels.jit import kernel
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import by_destination, id_range, owners_by_range, send_rows
from particles_mpi.particles import Array, Particles, rows_of


def ids_of(graph: ContactGraph, walls: int) -> tuple[Array, Array]:
    """(id of the row, partner) of all half-edges of the graph, and then of its rows with each of the walls."""
    n = len(graph.rows)
    row = np.concatenate((np.repeat(np.arange(n), np.diff(graph.start)), np.repeat(np.arange(n), walls)))
    return graph.id[row], np.concatenate((walls + graph.id[graph.other], np.tile(np.arange(walls), n)))


def remember(graph: ContactGraph, impulses: Array, walls: int) -> Memory:
    """The contacts of the graph's rows, with partners and with walls, that have an impulse along their normal."""
    of = np.flatnonzero(along_normals(impulses))
    ids, partners = ids_of(graph, walls)
    return Memory(ids[of], partners[of], impulses[of])


def recall(memory: Memory, graph: ContactGraph, walls: int) -> Array:
    """Impulses of all half-edges of the graph, then of its rows with each wall; 0 where nothing is remembered."""
    ids, partners = ids_of(graph, walls)
    order = np.argsort(memory.id, kind="stable")
    return np.asarray(match(ids, partners, memory.id[order], memory.partner[order], memory.taken[order]))


def along_normals(impulses: Array) -> Array:
    """The impulses along the normals (m,); those of rough spheres have further columns."""
    return impulses if impulses.ndim == 1 else np.ascontiguousarray(impulses[:, 0])


def carry_over(old: ContactGraph, last_impulses: Array, new: ContactGraph, walls: int) -> Array:
    """As `recall`, from the `last_impulses` of an `old` graph of the same rows, without a search for ids: five times as fast."""
    known, wanted = (old.index, old.start, old.id[old.other], last_impulses), (new.rows, new.start, new.id[new.other])
    return np.asarray(copy_impulses(known, wanted, walls))


@kernel
def copy_impulses(old, new, walls):
    """The impulses of a new graph, in the order that `ids_of` gives.

    old: (index, start, ids of partners, impulses); new: (rows, start, ids).
    """
    index, old_start, known, last_impulses = old
    rows, start, ids = new
    impulses = np.zeros((len(ids) + walls * len(rows), *last_impulses.shape[1:]))
    for n in range(len(rows)):
        m = index[rows[n]]
        if m < 0:
            continue
        c, last = old_start[m], old_start[m + 1]
        for e in range(start[n], start[n + 1]):  # both in the order of ids
            while c < last and known[c] < ids[e]:
                c += 1
            if c < last and known[c] == ids[e]:
                impulses[e] = last_impulses[c]
        for wall in range(walls):
            impulses[len(ids) + n * walls + wall] = last_impulses[len(known) + m * walls + wall]
    return impulses


@kernel
def match(ids, partners, known_id, known_partner, known_impulses):
    """The impulses of the contacts (ids, partners), 0 for those that are not known; `known_id` ascends."""
    impulses = np.zeros((len(ids), *known_impulses.shape[1:]))
    first = last = np.int64(0)
    for e in range(len(ids)):
        if e == 0 or ids[e] != ids[e - 1]:
            first = np.searchsorted(known_id, ids[e])
            last = first
            while last < len(known_id) and known_id[last] == ids[e]:
                last += 1
        for c in range(first, last):
            if known_partner[c] == partners[e]:
                impulses[e] = known_impulses[c]
    return impulses


def send_home(ranks: Communicator, memory: Memory, p: Particles) -> Memory:
    """The contacts of our rows, after rows have changed their rank. Collective.

    Contacts whose row is no longer here go to the rank responsible for its id (`owners_by_range`); ranks that have rows without
    contacts ask there.
    """
    if ranks.size == 1:
        return memory
    here = np.isin(memory.id, p.id)
    if ranks.all(here.all()):
        return memory
    known = id_range(ranks, p.id)

    def send(columns: dict[str, Array], to: Array) -> tuple[dict[str, Array], Array]:
        return send_rows(ranks, columns, *by_destination(to, ranks.size))

    def middle(ids: Array) -> Array:
        return owners_by_range(np.clip(ids, known.first, known.end - 1), known, ranks.size)

    strays = {name: column[~here] for name, column in memory._asdict().items()}
    strays, _ = send(strays, middle(strays["id"]))
    without = p.id[~np.isin(p.id, memory.id)]
    requested, counts = send({"id": without}, middle(without))
    order = np.argsort(requested["id"])
    ids, owner = requested["id"][order], np.repeat(np.arange(ranks.size), counts)[order]
    place = np.minimum(np.searchsorted(ids, strays["id"]), max(len(ids) - 1, 0))
    found = np.flatnonzero(ids[place] == strays["id"]) if len(ids) else np.empty(0, np.int64)
    ours, _ = send(rows_of(strays, found), owner[place[found]])
    return Memory(*(np.concatenate((column[here], ours[name])) for name, column in memory._asdict().items()))
