"""Contacts that last: spheres that forces press onto walls and one another come to rest there.

operator    called after each kick, and where crowds are found
solution    which contacts of a graph are slow, and the velocities that keep them
history     the graph of near rows, and the last impulses of contacts
graph       which rows of a rank, and ghosts, are near one another
detection   which of these pairs may have contacts that last
slow        which contacts are slow, and so are kept
zone        the box in which contacts are sought; crowds
rows        the state of the rows, copied from the particles and written back
problem     the contacts as a table with one row for each half-edge; rough_table: the same for rough spheres
surfaces    what differs between smooth and rough spheres
solver      chooses how to solve: on all ranks together, on each rank for all if contacts are few, or directly
descent     iterations to velocities with which no contact closes
iterations  their compiled loops; smooth_iterations, rough_iterations: the work on a row of smooth or rough spheres
direct      a direct solution for few contacts of smooth spheres, where iterations do not end; active_set: its equations
walls       the walls at which contacts last, and the rows near them; on_walls: the solution for rows that touch only walls
memory      the last impulses of contacts, which are sent where their rows are sent
"""
