"""Eight float64 at once, for kernels in which the compiler does not find by itself what a processor can do together.

A value of the type `Lanes` holds `WIDTH` numbers; +, -, *, `fma` and the formulas made of them act on each by itself, so that the
bits are those of single numbers, whatever the length of the processor's vectors. `eight` repeats a number, `load` and `store`
take eight numbers in a row from an array (n,) and put them back.
"""

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, models, register_model

WIDTH = 8
VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
PLACE = ir.IntType(32)


class Lanes(types.Type):
    """The type of eight numbers."""

    width = WIDTH


LANES = Lanes("Lanes")


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """Eight numbers are one value of the compiler's."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, VECTOR)


def _by_lane(operation: Any, instruction: str, operands: int = 2) -> None:
    """Let an operator act on each of the numbers."""
    kinds = (LANES,) * operands
    infer_global(operation)(type(f"Lanes_{instruction}", (ConcreteTemplate,), {"cases": [signature(LANES, *kinds)]}))

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return getattr(builder, instruction)(*arguments)

    lower_builtin(operation, *kinds)(generate)


_by_lane(operator.add, "fadd")
_by_lane(operator.sub, "fsub")
_by_lane(operator.mul, "fmul")
_by_lane(operator.neg, "fneg", 1)


@lower_cast(types.float64, LANES)
def _repeated(context: Any, builder: Any, number: Any, kind: Any, value: Any) -> Any:
    empty = ir.Constant(VECTOR, ir.Undefined)
    one = builder.insert_element(empty, value, ir.Constant(PLACE, 0))
    return builder.shuffle_vector(one, empty, ir.Constant(ir.VectorType(PLACE, WIDTH), [0] * WIDTH))


def _eight(typing: Any, value: Any) -> Any:
    """The float64 eight times."""
    return LANES(value), lambda context, builder, signature, arguments: _repeated(context, builder, value, LANES, *arguments)


def _address(context: Any, builder: Any, kind: Any, arguments: Any) -> Any:
    """Where eight numbers of an array (n,) begin: arguments are the array and the place of the first."""
    held = context.make_array(kind)(context, builder, arguments[0])
    return builder.bitcast(builder.gep(held.data, [arguments[1]]), VECTOR.as_pointer())


def _load(typing: Any, array: Any, first: Any) -> Any:
    """The numbers array[first], ..., array[first + 7] of an array (n,) without gaps."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_address(context, builder, array, arguments), align=8)

    return LANES(array, types.int64), generate


def _store(typing: Any, array: Any, first: Any, value: Any) -> Any:
    """Put eight numbers to array[first], ..., array[first + 7]."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[2], _address(context, builder, array, arguments), align=8)
        return context.get_dummy_value()

    return types.void(array, types.int64, LANES), generate


eight: Any = intrinsic(_eight)
load: Any = intrinsic(_load)
store: Any = intrinsic(_store)
