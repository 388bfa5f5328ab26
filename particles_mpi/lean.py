"""`@lean` compiles like `@njit(cache=True)`, without reference counts.

Numba counts references to arrays with locked instructions wherever a function unpacks a tuple of them or takes a part of one.
In a kernel that does little a call that was half of the time. The price: such a function cannot make an array.
"""

from __future__ import annotations

from typing import Any

from numba import njit

lean: Any = njit(cache=True, _nrt=False)  # type: ignore[call-overload]
