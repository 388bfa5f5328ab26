"""The entry point of the program. It handles signals before the imports, so that a signal during them leaves no traceback."""

import gc
import sys

from particles_mpi.errors import SceneError
from particles_mpi.parallel.signals import exit_on_signals

exit_on_signals()
gc.disable()  # nearly all that a start makes stays: to look at it again and again took an eighth of its time; see `cli.main`

try:
    from particles_mpi.cli import main
except SceneError as error:  # numba has no folder for kernels
    print(f"particles-mpi: {error}", file=sys.stderr)
    sys.exit(error.exit_code)

if __name__ == "__main__":
    main()
