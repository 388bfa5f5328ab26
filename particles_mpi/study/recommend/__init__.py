"""Finds which setting of a scene reaches a tolerance at the least cost, by measurement; predicts what a scene will cost.

runs             the runs that are compared: all from one start of a scene; what is kept of each, what each has cost
methods          the ways in which a scene can be computed
error_metric     how wrong a run is, in numbers that suit its kind of motion, and the smallest error that can be measured
reference        the solution with which runs are compared
search           the cheapest resolution of each method that reaches a tolerance
recommend        `study recommend`: reference, search, fair times, verification at half the step, report
tuned            the scene file with the recommended settings, and all else as its author wrote it
lost_collisions  how many collisions mode `rewind` loses compared with mode `event`, for `check`
predict          the seconds and errors that `check` predicts
"""
