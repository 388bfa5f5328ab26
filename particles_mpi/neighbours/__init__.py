"""Which particles can touch: straight paths, cells, candidates that hold for some steps, and the ghosts of other ranks."""
