"""What a user may read and change between two steps.

- `state`: particles, clock, counts and scene of a simulation, and what is made anew when they change
- `membership`: particles that are added and taken away, and data of the user's own
- `views`: the particles as a user sees them, and what was changed there; `options`: the same of effects
- `saved`: copied, compared, printed, saved and read back
"""
