"""Contacts that last: spheres that forces press onto walls and one another come to rest there.

operator    what happens after a kick, and with crowds
solution    which contacts are slow, and what they come to
history     the graph, and the last impulses of contacts
graph       who is near whom, among the rows of a rank and their ghosts
detection   which of these may have contacts that last
slow        which contacts are slow, and so kept
zone        where contacts are sought; crowds
rows        state of the rows, copied from the particles and written back
problem     the contacts as a table, one row for each half-edge; rough_table: the same of rough spheres
surfaces    what such a table says of smooth and of rough spheres
solver      which way these are solved: by all ranks together, or few contacts by each for all
descent     iterations to velocities at which none of them closes
iterations  their compiled loops; smooth_iterations, rough_iterations: what they do with the rows of smooth and of rough spheres
direct      few contacts of smooth spheres where iterations do not end; active_set: their equations, and in which order
walls       at which contacts last, and which rows they concern; on_walls: the solution for those that touch nothing else
memory      the last impulses of contacts, which go with the rows
"""
