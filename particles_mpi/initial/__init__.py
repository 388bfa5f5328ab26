"""The particles with which a scene starts, and the checks of their places.

Each rank makes a block of ids, and the result does not depend on how many ranks there are. In the order of their use:

- `populate`: one quantity after the other, population by population; `columns`: a rank's share of a population, in its columns
- `table_file`: columns of CSV files, of which each rank reads a part
- `quantities`: radius, mass, spin, places and velocities
- `random_numbers`: by (seed, population, quantity, number of the particle); `plummer`: places and speeds of a star cluster
- `lattices`: places by a formula of the number; `room`: the space that they have
- `random_addition`: random places without overlap; each rank judges those in its part of space
- `sphere_grid`: who overlaps whom; `sphere_cells`: the linked cells in which spheres are found
- `checks`: what only the particles can tell; `start_warnings`: what is no fault, but told
- `overlaps`: spheres that overlap, which may be pushed apart
- `faults`: what is wrong, collected over the ranks, with the lowest ids
"""
