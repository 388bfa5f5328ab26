"""Which particles can touch: straight paths, cells, candidates that hold for some steps, and the ghosts of other ranks.

Mode `rewind` (`contacts/time_stepped`) searches by candidates. The files, in the order in which one reads them:

    trajectories      the straight path that each particle is expected to follow until a horizon, give or take a tolerance
    cells             linked cells: a grid, rows sorted by cell, and lists of rows a cell
    search_index      how rows are held in cells, and put elsewhere when their paths change
    near_paths        do two paths come near each other, and when
    partner_lists     which rows are in cells near a path
    pair_search       which rows are tested, then, and found to be partners; the compiled call for all rows, or for a few
    candidates        one search: all pairs and all particles near walls, and how those are replaced whose paths changed
    rank_boxes        boxes of ranks, and which rows get into them
    halo_region       the ghosts that a rank needs for that, and until when its particles meet no unknown one
    pass_messages     what ranks tell one another of ghosts in a pass over contacts
    rebuild_interval  for how many steps a search shall hold, so that the whole costs least
    neighbour_list    `Neighbourhood`: all of it for one rank, step by step

The way of one search (`Neighbourhood.search`): particles move to the ranks in whose space they are; all ranks agree on the
`Horizon`; rows near in space are sorted near in memory; `halo_region` fetches the ghosts; `Candidates.search` lays paths, fills
cells and finds the pairs. It then holds for many steps: `prepare` gives new paths to the few rows that forces bent away from
theirs, `follow` to those that a contact turned, and each asks for new partners by itself. Only when the horizon has passed, or a
row would get where its rank does not know everyone, is all searched anew.

Mode `event` (`contacts/event_driven`) moves particles one at a time, and has neighbour lists for that instead:

    verlet_cells      cells in levels of size, whose rows come and go one at a time
    verlet_kernels    a list of neighbours for each particle, which holds while it stays near a reference position
    verlet_lists      the lists of all particles of a rank

Whatever is found here is a superset of what touches: how tight it is costs time, and never changes a result.
"""
