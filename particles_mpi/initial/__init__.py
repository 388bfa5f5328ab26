"""The particles at the start of a scene, and the checks of their positions.

Each rank makes a block of ids, and the result does not depend on how many ranks there are. In the order of their use:

- `populate`: makes one quantity after the other, population by population; `columns`: a rank's share of a population
- `table_file`: columns of CSV files, of which each rank reads a part
- `quantities`: radius, mass, spin, positions and velocities
- `random_numbers`: by (seed, population, quantity, number of the particle); `plummer`: positions and speeds of a star cluster
- `lattices`: positions by a formula of the number; `room`: the space for particles
- `random_addition`: random positions without overlap; each rank decides on those in its part of space
- `sphere_grid`: finds spheres that overlap; `sphere_cells`: the linked cells in which it looks
- `checks`: faults that only the particles can show; `start_warnings`: warnings about a start that is allowed
- `overlaps`: spheres that overlap, which may be pushed apart
- `faults`: collects faults over the ranks, and names the lowest ids
"""
