"""Which kernels are in files of the cache of numba: `python tests/kernel_names.py FILE.nbc...` prints a line for each.

A process of its own, because to read a signature imports the modules whose bundles are among the arguments, and with them MPI.
Kernels for more than three axes are left out: those are compiled when they are needed.
"""

import pickle
import sys
from pathlib import Path


def many_axes(signature):
    """Is the first argument more than three axes, or any one their number?"""
    axes = getattr(signature[0], "count", None) if signature else None
    numbers = [axes, *(getattr(kind, "literal_value", None) for kind in signature)]
    return any(isinstance(number, int) and number > 3 for number in numbers)


files = [Path(name) for name in sys.argv[1:]]
for index in sorted({path.with_name(path.name.rsplit(".", 2)[0] + ".nbi") for path in files}):
    with index.open("rb") as file:
        pickle.load(file)  # numba's version
        _, overloads = pickle.loads(file.read())
    for (signature, *_), name in overloads.items():
        if index.with_name(name) in files and not many_axes(signature):
            print(index.name, signature)
