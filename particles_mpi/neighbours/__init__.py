"""Which particles can touch: straight paths, cells, candidates that hold for some steps, and the ghosts of other ranks.

Mode `rewind` (`contacts/time_stepped`) searches by candidates. The files, in the order in which to read them:

    trajectories      the straight path that each particle is expected to follow until a horizon, within a tolerance
    cells             linked cells: a grid, rows sorted by cell, and a list of rows for each cell
    search_index      how rows are stored in cells, and moved to others when their paths change
    near_paths        a test of two paths: do they come near each other, and when?
    partner_lists     lists the rows in cells near a path
    pair_search       the compiled search for pairs, for all rows or for a few; it uses the three files above
    candidates        one search: all pairs and all particles near walls, and new ones for rows whose paths changed
    rank_boxes        boxes around the rows of ranks, and which rows come into them
    halo_region       which ghosts a rank needs for that, and until when its particles cannot meet an unknown one
    pass_messages     the messages about ghosts in a pass over contacts
    rebuild_interval  chooses for how many steps a search holds, so that the total cost is least
    neighbour_list    `Neighbourhood`: all of this for one rank, step by step

The course of one search (`Neighbourhood.search`): particles are sent to the ranks in whose space they are; all ranks agree on the
`Horizon`; rows near in space are sorted near in memory; `halo_region` fetches the ghosts; `Candidates.search` makes paths, fills
cells and finds the pairs. The result holds for many steps. `prepare` gives new paths to the few rows that forces bent away from
theirs, `follow` to those that a contact turned, and each of these looks for new partners by itself. Everything is searched again
only when the horizon has passed, or when a row would get to a place where its rank does not know all others.

Mode `event` (`contacts/event_driven`) moves particles one at a time, and uses neighbour lists instead:

    verlet_cells      cells in levels of size, whose rows come and go one at a time
    verlet_kernels    a list of neighbours for each particle, which holds while it stays near a reference position
    verlet_lists      the lists of all particles of a rank

The pairs that are found include all that touch, and others: how many others costs time, and never changes a result.
"""
