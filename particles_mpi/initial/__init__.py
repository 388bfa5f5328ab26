"""The particles with which a scene starts, and the checks of their places.

`populate` builds them, population by population; `placement` finds random places and lattices, `plummer` Plummer's sphere.
`checks` asks what only the particles can tell, `overlaps` finds those that overlap and pushes them apart, `names` tells who
they are in a fault.
"""
