"""`@lean` compiles like `@njit(cache=True)`, without reference counts.

Numba counts references to arrays with locked instructions wherever a function unpacks a tuple of them or takes a part of one.
In a kernel that does little a call that was half of the time. The price: such a function cannot make an array.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

lean: Any = njit(cache=True, _nrt=False)  # type: ignore[call-overload]


def _prefetch(typing: Any, array: Any, row: Any) -> Any:
    """Ask for the beginning of array[row] to be in the cache soon, without waiting for it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = signature.args[0]
        held = context.make_array(kind)(context, builder, arguments[0])
        place = builder.sext(arguments[1], ir.IntType(64)) if arguments[1].type.width < 64 else arguments[1]
        places = [place] + [ir.Constant(ir.IntType(64), 0)] * (kind.ndim - 1)
        address = cgutils.get_item_pointer(context, builder, kind, held, places, wraparound=False)
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), [byte, number, number, number]), "llvm.prefetch.p0i8"
        )
        read, keep, data = (ir.Constant(number, value) for value in (0, 3, 1))
        builder.call(function, [builder.bitcast(address, byte), read, keep, data])
        return context.get_dummy_value()

    return types.void(array, row), generate


prefetch: Any = intrinsic(_prefetch)
