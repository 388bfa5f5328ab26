"""The rows of a rank in mode `event` on several ranks: its own, and as ghosts those that they may meet in a step.

Space is divided into regions. A rank owns the particles whose reference positions are in its region. It has those near it as
ghosts; an error that begins outside must pass through all this depth to reach its own rows. Reference positions, and with them
the owners and holders of rows, change within a step; the fields of particles are sent at its end.
"""

import numpy as np

from particles_mpi.contacts.event_driven.engine import Engine
from particles_mpi.contacts.event_driven.id_table import rows_of_ids, table_of
from particles_mpi.contacts.event_driven.messages import HOLDER, PLACE, Directory, message_of, pack_changes, widest_part
from particles_mpi.contacts.event_driven.regions import Moves, Regions, distances2, mark_holders, plan_moves
from particles_mpi.contacts.event_driven.rows import (
    ID,
    LAST_PARTNER,
    NOT_HERE,
    OWN,
    OWNERSHIP,
    RAPID_EVENTS,
    SHARED,
    TRAJECTORY_HASH,
)
from particles_mpi.kernels.geometry import Box, wrap
from particles_mpi.kernels.markers import NO_PARTNER, START
from particles_mpi.kernels.memory import doubled, enlarged
from particles_mpi.neighbours.cells import bounds, order_in_space
from particles_mpi.neighbours.verlet_cells import MARGIN
from particles_mpi.neighbours.verlet_kernels import SIZE
from particles_mpi.neighbours.verlet_lists import contact_distance
from particles_mpi.parallel.buffers import RowBuffers
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.decomposition import LoadBalance
from particles_mpi.parallel.exchange import by_destination, send_rows, sendrecv
from particles_mpi.particles import Array, Particles, field
from particles_mpi.timers import Timers

DISPLACEMENT_BOUND = 0.25  # of a skin: how far a row may get in a window
DEPTH = 1.4  # mean diameters: thickness of the ghosts beyond those that own particles can touch, through which errors must come
MOST_ON_ONE_RANK = 0.75  # of all particles on one rank, ghosts included: then each may as well compute everything


class Partition:
    """The rows of this rank in an engine, and which ranks hold them.

    version: of the particles that the rows are of, or -1; own_rows (particles,): the row of each; neighbours: the ranks that
    messages go to; directory: which ranks hold a row; skin: of the neighbour lists of all ranks, a length; depth: of the ghosts,
    in mean diameters; one_holds_most: does a rank hold nearly all? Counted: redistributions (`searches`), particles that this
    rank sent to other ranks (`migrated`), and ghosts.
    """

    directory: Directory
    regions: Regions

    def __init__(self, particles: Particles, ranks: Communicator, engine: Engine, box: Box, timers: Timers):
        self.particles, self.ranks, self.engine, self.box = particles, ranks, engine, box
        self.balance, self.row_buffers = LoadBalance(ranks, timers), RowBuffers(particles)
        self.version = -1
        self.searches = self.migrated = self.ghost_rows = 0
        self.one_holds_most = False
        self.depth = DEPTH
        self.total = ranks.total(len(particles))[0]

    def redistribute(self) -> None:
        """Send particles to the ranks whose regions they are in, and ghosts to all that need them; make new lists. Collective."""
        p, engine, ranks, lists = self.particles, self.engine, self.ranks, self.engine.lists
        self.balance.update(p, self.searches)
        self.row_buffers.adopt()
        inside = p.position.copy()
        wrap(inside, *self.box)
        self.migrated += self.row_buffers.migrate(ranks, self.balance.decomposition.owner(inside))
        n, d = len(p), p.dimension
        if n > 1:
            self.row_buffers.sort(order_in_space(p.position, bounds(p.position)))
        w = p.inverse_mass
        largest, movable = ranks.allreduce_max(np.array(contact_distance(p.radius, w))).tolist()
        lists.tune(p.position, p.radius, w, largest + movable, way=0.0)
        self.skin = ranks.largest(lists.skin if n else 0.0)[0]
        mean = float(ranks.allreduce_sum(p.radius.sum())[0]) / max(self.total, 1)
        lists.width = self.skin
        self.divide(largest, mean)
        known = len(self.regions.known)
        holders = np.zeros((n, known // 64 + 1), np.int64)
        reference = lists.arrays.reference
        reference[:n, d + SIZE] = p.radius + np.where(p.inverse_mass > 0.0, self.skin, 0.0)
        mark_holders(reference, np.arange(n, dtype=np.int32), tuple(self.regions), holders)
        held = [np.flatnonzero(holders[:, k >> 6] >> (k & 63) & 1) for k in range(known - 1)]
        shared, counts = np.concatenate([*held, np.empty(0, np.int64)]).astype(np.int64), np.zeros(ranks.size, np.int32)
        counts[self.neighbours] = list(map(len, held))
        sent = {name: column for name, column in p.arrays.items() if field(name).ghost or name == "virial"}
        arrived, _ = send_rows(ranks, sent, shared, counts)
        here = Particles(d, {name: np.concatenate((column, arrived[name])) for name, column in sent.items()})
        ghosts = len(here) - n
        spare = ghosts // 2 + 256
        lists.share = self.total / max(len(here), 1)
        lists.build(here.position, here.radius, here.inverse_mass, spare)
        engine.load(here, n, spare)
        engine.rows.state[shared, OWNERSHIP] = SHARED
        total = len(here) + spare
        self.directory = Directory(
            table_of(here.id, np.arange(len(here)), total),
            enlarged(holders, np.zeros((total, holders.shape[1]), np.int64)), np.zeros((total, 2), np.int64),
            np.zeros(total, np.int64), np.roll(np.arange(total, dtype=np.int32), spare), np.array([spare]),
        )  # fmt: skip
        self.own_rows = np.arange(n, dtype=np.int32)
        self.one_holds_most = ranks.largest(len(here))[0] > MOST_ON_ONE_RANK * self.total
        self.ghost_rows += ghosts
        self.version = p.version
        self.searches += 1

    def divide(self, largest: float, mean: float) -> None:
        """Set the regions of all ranks, and which may have to exchange messages; `largest`, `mean`: radius of all particles."""
        me, domain, length = self.ranks.rank, self.balance.decomposition, self.box.length
        low = np.where(length > 0.0, np.maximum(domain.lower, self.box.lower), domain.lower)
        high = np.where(length > 0.0, np.minimum(domain.upper, self.box.upper), domain.upper)
        bound = DISPLACEMENT_BOUND * self.skin
        reach = (self.skin + 2.0 * bound + largest) * MARGIN
        depth = (reach + 2.0 * max(self.depth * mean, largest)) * MARGIN
        within = depth + largest + self.skin + 2.0 * self.skin + bound
        near = distances2(low, high, me, length) <= within**2
        self.neighbours = [int(rank) for rank in np.flatnonzero(near) if rank != me]
        self.regions = Regions(low, high, tuple(self.box), me, np.array([*self.neighbours, me]), reach, bound, depth)

    def locate_fields(self) -> None:
        """Record that the fields of own particles are on this rank, in their order, as at the start of a drift."""
        self.directory.fields_at[self.own_rows, HOLDER] = self.ranks.rank
        self.directory.fields_at[self.own_rows, PLACE] = np.arange(len(self.particles))

    def send_motion(self) -> None:
        """Start ghosts on the same segments as the rows of their owners. Collective."""
        rows, holders, d = self.engine.rows, self.directory.holders, len(self.box.length)
        shared = np.flatnonzero(rows.state[:, OWNERSHIP] == SHARED)
        numbers = [rows.state[shared, ID].view(float), rows.segment[shared, : 2 * d]]
        numbers += [column[shared] for column in (rows.acceleration, rows.spin) if len(column)]
        table = np.column_stack(numbers)
        outgoing = [table[(holders[shared, k >> 6] >> (k & 63) & 1) == 1].ravel() for k in range(len(self.neighbours))]
        arrived = sendrecv(self.ranks, self.neighbours, outgoing).reshape(-1, table.shape[1])
        ghosts = rows_of_ids(self.directory.table, arrived[:, 0].copy().view(np.int64))
        rows.segment[ghosts, : 2 * d], rows.segment[ghosts, 2 * d + START] = arrived[:, 1 : 2 * d + 1], 0.0
        rows.state[ghosts, LAST_PARTNER] = NO_PARTNER
        rows.state[ghosts, RAPID_EVENTS] = rows.state[ghosts, TRAJECTORY_HASH] = 0
        at = 2 * d + 1
        for column in (rows.acceleration, rows.spin):
            if len(column):
                column[ghosts] = arrived[:, at : at + column.shape[1]]
                at += column.shape[1]

    def plan_moves(self) -> Moves:
        """Find, for own rows that got new reference positions, which ranks must hold them, and which one owns them."""
        log, domain = self.engine.log, self.balance.decomposition
        moved = int(log.moved_count[0])
        moves = Moves(np.zeros((moved, self.directory.holders.shape[1]), np.int64), np.empty(moved, np.int64))
        tree = domain.axis, domain.cut, domain.below, domain.above
        plan_moves(self.engine.lists.arrays.reference, tuple(log), tuple(self.regions), tree, tuple(moves))
        return moves

    def changes_for(self, bit: int, moves: Moves) -> Array:
        """Return the message about what happened in the window, for the known rank of a bit."""
        engine, log, d = self.engine, self.engine.log, len(self.box.length)
        parts = int(log.border_count[0]) + 3 * int(log.moved_count[0])
        message = message_of(np.empty(parts * widest_part(d)))
        rows, directory, reference = tuple(engine.rows), tuple(self.directory), engine.lists.arrays.reference
        regions = tuple(self.regions)
        size = pack_changes(rows, reference, directory, tuple(log), tuple(moves), regions, bit, message)
        return message[0][:size].copy()  # the rest of the room is given back

    def grow(self) -> None:
        """Make room for more rows, when more came near than there is room for."""
        more, old = self.engine.grow(), self.directory
        old.free_count[0] = len(more)
        state = self.engine.rows.state
        here = np.flatnonzero(state[:, OWNERSHIP] != NOT_HERE)
        self.directory = doubled(old, "holders", "fields_at", "updated")._replace(
            free=np.concatenate((more, old.free)), table=table_of(state[here, ID], here, len(state))
        )

    def migrate(self) -> None:
        """Send the fields of particles that changed owner to their new owners. Collective."""
        p, ranks, fields_at = self.particles, self.ranks, self.directory.fields_at
        came = np.flatnonzero((self.engine.rows.state[:, OWNERSHIP] >= OWN) & (fields_at[:, HOLDER] != ranks.rank))
        order, counts = by_destination(fields_at[came, HOLDER], ranks.size)
        requested, of = send_rows(ranks, {"row": fields_at[:, PLACE]}, came[order], counts)
        owner = np.full(len(p), ranks.rank)
        owner[requested["row"]] = np.repeat(np.arange(ranks.size), of)
        self.row_buffers.adopt()
        self.migrated += self.row_buffers.migrate(ranks, owner)
        self.own_rows = rows_of_ids(self.directory.table, p.id).astype(np.int32)
        self.version = p.version
