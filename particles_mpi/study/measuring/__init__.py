"""Fair timing of simulations, and what an experiment is."""
