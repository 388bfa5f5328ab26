"""Mutual attraction of all particles: the direct sum over all pairs, and a tree of multipoles.

In the order in which to read them:

- `method`: chooses direct sum or tree, by cost and error
- `direct`: the sum over all pairs, for each target in the order of ids
- `octree`: Morton keys, cells, moments, and the opening test `is_far`
- `powers`: r^(-1/2) and r^(-3/2) by products and sums
- `expansion`: one Taylor expansion that collects all far cells, for a small group of targets
- `sources`: particles and cells that act on each target of a group, in float64 or float32
- `walk`: finds the sources that act on a group of targets, and how each of them acts
- `tree`: the evaluation on all ranks, step by step: cuts between ranks, and the nodes that another rank needs

Direct sum: blocks of sources in id order come from every rank in turn (`parallel.exchange.blocks`), and every target adds them up
in that order (`direct.Attraction`). Tree: each particle is sent to the rank that owns the Morton key of its position. That rank
builds the cells of its keys, sends to other ranks the nodes that are essential to them, and joins what arrives with its own part
to one tree, which it walks for each group of its targets. The results return to the ranks from which the particles came.
"""
