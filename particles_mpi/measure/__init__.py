"""Measurements of a state.

- `diagnostics`: energies, momentum and observables, a row of the table
- `snapshot`: the whole state on one rank, to compare, print and save it
- `watchdog`: checks that all particles are there, finite, and inside
"""
