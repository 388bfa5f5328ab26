"""The basis of compiled kernels: how they are compiled, and small kernels that all folders use.

- `jit`: the decorators that compile; `loading`: loads kernels from numba's cache quickly
- `lanes`: eight numbers at once; `memory`: arrays that begin with lines of the cache, and larger copies of arrays
- `limits`: what 32 bits can count; `markers`: numbers with a special meaning in arrays
- `geometry`: distances and places in a periodic box; `planes`: walls as arrays
- `motion`: kicks and straight segments; `sliding`: motion under friction; `turning`: orientations that follow spins
- `validity`: checks that all particles are finite and inside; `fingerprint`: a hash that shows whether an array has changed

The program does not start if no folder for compiled kernels can be written: numba would raise an error at each of them.
"""

from numba import njit

from particles_mpi.errors import SceneError

try:
    njit(cache=True)(lambda: None)  # numba looks for a folder as it does for each kernel
except RuntimeError:
    where = "neither beside the program, nor in the home folder"
    raise SceneError(f"compiled kernels can be kept {where}: set NUMBA_CACHE_DIR to a folder that can be written") from None
