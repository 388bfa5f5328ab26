"""What compiled kernels stand on: how they are compiled, eight numbers at once, distances in a periodic box, segments and kicks.

Nothing of the program starts where no folder for compiled kernels can be written: numba would raise an error at each of them.
"""

from numba import njit

from particles_mpi.errors import SceneError

try:
    njit(cache=True)(lambda: None)  # numba looks for a folder as it does for each kernel
except RuntimeError:
    where = "neither beside the program, nor in the home folder"
    raise SceneError(f"compiled kernels can be kept {where}: set NUMBA_CACHE_DIR to a folder that can be written") from None
