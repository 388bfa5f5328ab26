"""What compiled kernels stand on: how they are compiled, distances in a periodic box, straight segments and kicks."""
