"""Every MPI call of the program: moving rows to ranks, sharing ghosts, sums. Knows nothing of physics."""
