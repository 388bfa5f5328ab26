"""Which setting of a scene reaches a tolerance at the least cost, measured; and what a scene will cost before it runs.

runs             the runs that are compared: all from one start of a scene, what is kept of each, what each has cost
methods          the ways in which a scene can be computed
error_metric     how wrong a run is, in numbers that mean something for its kind of motion, and how finely that can be measured
reference        the solution that errors are measured against
search           the cheapest resolution of each method that reaches a tolerance
recommend        `study recommend`: reference, search, fair times, verification at half the step, report
tuned            the scene file with the recommended settings, and all else as its author wrote it
lost_collisions  what mode `rewind` loses beside mode `event`, for `check`
predict          what `check` tells of seconds and errors beforehand
"""
