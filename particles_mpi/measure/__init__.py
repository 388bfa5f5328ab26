"""Measurements of a state.

- `diagnostics`: energies, momentum and observables, a row of the table
- `energy_change`: whether the energy of a run has changed though it should not
- `snapshot`: the whole state on one rank, to compare, print and save it
- `watchdog`: checks that all particles are there, finite, and inside
"""
