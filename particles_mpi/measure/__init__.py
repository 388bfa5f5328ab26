"""What is measured of a state: energies, observables, the whole state as a text, and whether it is sound."""
