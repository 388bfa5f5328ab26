"""Which kernels are in files of the cache of numba: `python tests/kernel_names.py FILE.nbc...` prints a line for each.

A process of its own, because to read a signature imports the modules whose bundles are among the arguments, and with them MPI.
Kernels for more than three axes are left out: those are compiled when they are needed.
"""

import pickle
import sys
from pathlib import Path


def many_axes(signature):
    """Is the first argument more than three axes, or their number?"""
    if not signature:
        return False
    number = getattr(signature[0], "count", None) or getattr(signature[0], "literal_value", None)
    return isinstance(number, int) and number > 3


files = [Path(name) for name in sys.argv[1:]]
for index in sorted({path.with_name(path.name.rsplit(".", 2)[0] + ".nbi") for path in files}):
    with index.open("rb") as file:
        pickle.load(file)  # numba's version
        _, overloads = pickle.loads(file.read())
    for (signature, *_), name in overloads.items():
        if index.with_name(name) in files and not many_axes(signature):
            print(index.name, signature)
