"""What is measured of a state.

- `diagnostics`: energies, momentum and observables, a row of the table
- `snapshot`: the whole state, gathered: to compare, print and save
- `watchdog`: is everyone there, finite, and inside?
"""
