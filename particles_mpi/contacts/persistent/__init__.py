"""Contacts that last: spheres that forces press onto walls and one another come to rest there.

operator    what happens after a kick, and with crowds; who is involved
graph       who is near whom, among the rows of a rank and their ghosts
detection   which contacts are slow, and so kept
solver      velocities at which none of these closes, solved by all ranks together
memory      what contacts took last, which goes with the rows
"""
