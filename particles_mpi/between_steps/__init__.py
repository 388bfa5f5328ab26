"""What a user may read and change between two steps.

- `state`: the particles, clock, counts and scene of a simulation, and what is rebuilt when they change
- `membership`: adds and removes particles, and attaches data of the user's own
- `views`: shows particles to a user and takes over changes; `options`: the same for the options of effects
- `saved`: copies, compares, prints, saves and restores a simulation
"""
