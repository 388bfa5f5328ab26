"""No row meets one that its rank does not know, though each rank sees only its own rows and their ghosts."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from test_candidates import at_start, closest, listed

from particles_mpi.kernels.planes import no_planes
from particles_mpi.neighbours.candidates import Candidates
from particles_mpi.neighbours.halo_region import Margins, build
from particles_mpi.neighbours.pair_search import LEAVING
from particles_mpi.neighbours.rank_boxes import swept_box
from particles_mpi.neighbours.trajectories import Horizon, Spheres


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    d=st.sampled_from([2, 3]),
    ranks=st.integers(2, 4),
    n=st.sampled_from([3, 80, 160]),
    periodic=st.booleans(),
    slack=st.sampled_from([0.05, 0.2, 1.0]),
    clearance=st.sampled_from([0.05, 0.2, 1.0]),
)
def test_turned_rows_meet_only_rows_that_their_rank_holds(seed, d, ranks, n, periodic, slack, clearance):
    random = np.random.default_rng(seed)
    side, end, half, now, h = (5.0 if d == 2 else 3.0) * (n / 40) ** (1 / d), 0.5, 0.02, 0.2, 1e-9
    x, v = random.random((n, d)) * side, random.normal(size=(n, d))
    radius, ids, w = random.random(n) * 0.1, random.permutation(n).astype(np.int64), np.ones(n)
    length = np.full(d, side if periodic else 0.0)
    bound = (side - 0.4) / 4.0 - half if periodic else np.inf
    if periodic:
        v *= min(1.0, 0.5 * bound / (end * np.sqrt((v**2).sum(axis=1)).max()))
    owner = np.minimum((x[:, 0] / side * ranks).astype(int), ranks - 1)
    mine = [np.flatnonzero(owner == p) for p in range(ranks)]
    horizon, margins = Horizon(end, half, bound), Margins(slack, clearance)
    boxes = np.array([swept_box(x[m], v[m], radius[m], horizon) for m in mine])
    fences = [build(boxes, p, (x[m], v[m], radius[m]), horizon, length, margins) for p, m in enumerate(mine)]

    turning = random.random(n) < 0.2
    after = np.where(turning[:, None], 6.0 * random.permutation(v), v)
    then = x + now * v
    searched, held = [], []
    for p in range(ranks):
        known = [mine[p]]
        for q, (_, rows, counts) in enumerate(fences):
            begin = counts[:p].sum()
            known.append(mine[q][rows[begin : begin + counts[p]]])
        all_ = np.concatenate(known)
        spheres = Spheres(radius[all_], w[all_], ids[all_], len(mine[p]))
        c = Candidates(x[all_], v[all_], spheres, length, tuple(no_planes(d)), horizon, fences[p][0], 0)
        c.x[:], c.v[:], c.time = then[all_], after[all_], now
        if c.follow(np.flatnonzero(turning[all_]).astype(np.int32), LEAVING, at_start(c), h):
            return  # someone gets over a fence in this very step: all would search anew
        searched.append(c)
        held.append(all_)
    end = min(c.horizon.valid_until for c in searched)
    near = closest(then, after, np.full(n, now), np.full((n, 1), end), length) <= (radius[:, None] + radius[None]) * (1 - 1e-12)
    for p, (c, all_) in enumerate(zip(searched, held, strict=True)):
        found = {frozenset(all_[list(pair)].tolist()) for pair in listed(c)}
        for i, j in np.argwhere(np.triu(near, 1)).tolist():
            assert frozenset((i, j)) in found or p not in (owner[i], owner[j])


def test_a_turned_row_does_not_leave_the_space_that_its_rank_knows():
    """A, near the border at x = 0 and known to both ranks, is turned towards B, of which its rank knows nothing."""
    x, v = np.array([[-0.1, 0.0], [5.0, 0.0], [9.0, 0.0]]), np.zeros((3, 2))
    radius, w, ids, length, end, half = np.full(3, 0.2), np.ones(3), np.arange(3), np.zeros(2), 1.0, 0.01
    a, b = np.array([0]), np.array([1, 2])
    horizon, margins = Horizon(end, half, np.inf), Margins(0.1, 0.1)
    boxes = np.array([swept_box(x[m], v[m], radius[m], horizon) for m in (a, b)])
    boxes[1, 0, 0] = -0.05  # some other row of the rank of B reaches there
    fence, rows, _ = build(boxes, 0, (x[a], v[a], radius[a]), horizon, length, margins)
    assert rows.tolist() == [0]
    c = Candidates(x[a], v[a], Spheres(radius[a], w[a], ids[a], 1), length, tuple(no_planes(2)), horizon, fence, 0)
    c.v[0] = 8.0, 0.0
    assert c.follow(np.array([0], np.int32), LEAVING, at_start(c), 1e-3) == 0.0
    assert 0.1 / 8.0 * 0.9 < c.horizon.valid_until <= 0.1 / 8.0
