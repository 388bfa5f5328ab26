"""Eight float64 at once, for kernels in which the compiler does not find by itself what a processor can do together.

A value of the type `Lanes` holds `LANE_COUNT` numbers. +, -, *, `fma`, `np.rint` and the formulas made of them act on each by
itself: the bits are those of single numbers, whatever the length of the processor's vectors. <, <= and > give an int64 with a bit
for each. A float64 beside them is repeated. `load` and `store` take eight numbers in a row from an array (n,) and put them back;
what `columns_of` makes takes eight rows of a table.
"""

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv.rules import default_type_manager
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import models, register_model

from particles_mpi.kernels.jit import intrinsic, repeated

LANE_COUNT = 8
VECTOR = ir.VectorType(ir.DoubleType(), LANE_COUNT)
PLACE = ir.IntType(32)


class Lanes(types.Type):
    """The type of eight numbers."""

    width = LANE_COUNT


LANES = Lanes("Lanes")


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """Eight numbers are one value of the compiler's."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, VECTOR)


def _by_lane(operation: Any, generate: Any, result: Any = LANES, operands: int = 2) -> None:
    """Let an operator act on each of the numbers; a float64 beside them is repeated."""
    kinds = (LANES,) * operands
    infer_global(operation)(type(f"Lanes_{operation.__name__}", (ConcreteTemplate,), {"cases": [signature(result, *kinds)]}))
    lower_builtin(operation, *kinds)(lambda context, builder, signature, arguments: generate(builder, *arguments))


def _comparison(relation: str) -> Any:
    """Of which numbers is it true? Bit p of an int64 for number p."""

    def generate(builder: Any, a: Any, b: Any) -> Any:
        return builder.zext(builder.bitcast(builder.fcmp_ordered(relation, a, b), ir.IntType(LANE_COUNT)), ir.IntType(64))

    return generate


def _rint(builder: Any, a: Any) -> Any:
    function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(VECTOR, [VECTOR]), f"llvm.rint.v{LANE_COUNT}f64")
    return builder.call(function, [a])


for _sum in (operator.add, operator.iadd):
    _by_lane(_sum, lambda builder, a, b: builder.fadd(a, b))
_by_lane(operator.sub, lambda builder, a, b: builder.fsub(a, b))
_by_lane(operator.mul, lambda builder, a, b: builder.fmul(a, b))
_by_lane(operator.neg, lambda builder, a: builder.fneg(a), operands=1)
for _relation, _sign in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">")):
    _by_lane(_relation, _comparison(_sign), types.int64)
_by_lane(np.rint, _rint, operands=1)
default_type_manager.set_safe_convert(types.float64, LANES)


@lower_cast(types.float64, LANES)
def _repeated(context: Any, builder: Any, number: Any, kind: Any, value: Any) -> Any:
    return repeated(builder, value, LANE_COUNT)


@intrinsic
def eight(typing: Any, value: Any) -> Any:
    """The float64 eight times."""
    return LANES(value), lambda context, builder, signature, arguments: _repeated(context, builder, value, LANES, *arguments)


def _address(context: Any, builder: Any, kind: Any, arguments: Any) -> Any:
    """Where eight numbers of an array (n,) begin: arguments are the array and the place of the first."""
    held = context.make_array(kind)(context, builder, arguments[0])
    return builder.bitcast(builder.gep(held.data, [arguments[1]]), VECTOR.as_pointer())


@intrinsic
def load(typing: Any, array: Any, first: Any) -> Any:
    """The numbers array[first], ..., array[first + 7] of an array (n,) without gaps."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_address(context, builder, array, arguments), align=8)

    return LANES(array, types.int64), generate


@intrinsic
def store(typing: Any, array: Any, first: Any, value: Any) -> Any:
    """Put eight numbers to array[first], ..., array[first + 7]."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[2], _address(context, builder, array, arguments), align=8)
        return context.get_dummy_value()

    return types.void(array, types.int64, LANES), generate


def columns_of(count: Any) -> Any:
    """A function that gives the first count(d) columns of eight rows of a table, for d axes, as many `Lanes`.

    Its arguments: axes; the table (n, .); rows (m,) int32; first, last: the rows are rows[first] and those behind it, and instead
    of those beyond rows[last] that one again.
    """

    def columns(typing: Any, axes: Any, table: Any, rows: Any, first: Any, last: Any) -> Any:
        """The columns of eight rows of a table."""
        width = count(len(axes))
        result = types.UniTuple(LANES, width)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            held, listed = (context.make_array(kind)(context, builder, arguments[k]) for k, kind in ((1, table), (2, rows)))
            stride = cgutils.unpack_tuple(builder, held.strides)[0]
            number, byte = ir.IntType(64), ir.IntType(8).as_pointer()
            begins, found = [], []
            for p in range(LANE_COUNT):
                place = builder.add(arguments[3], ir.Constant(number, p))
                place = builder.select(builder.icmp_signed("<", place, arguments[4]), place, arguments[4])
                row = builder.zext(builder.load(builder.gep(listed.data, [place])), number)
                begins.append(builder.gep(builder.bitcast(held.data, byte), [builder.mul(row, stride)]))
            for begin in range(0, width, LANE_COUNT):
                some = min(LANE_COUNT, width - begin)
                parts = [builder.gep(p, [ir.Constant(number, 8 * begin)]) for p in begins]
                found += _transposed(builder, [_row(builder, p, some) for p in parts])[:some]
            return context.make_tuple(builder, result, found)

        return result(axes, table, rows, types.int64, types.int64), generate

    return intrinsic(columns)


def _row(builder: Any, place: Any, some: int) -> Any:
    """So many numbers from an address on, and what comes after them is not asked for."""
    kind = ir.VectorType(ir.DoubleType(), some)
    numbers = builder.load(builder.bitcast(place, kind.as_pointer()), align=8)
    lanes = ir.Constant(ir.VectorType(PLACE, LANE_COUNT), [min(k, some - 1) for k in range(LANE_COUNT)])
    return numbers if some == LANE_COUNT else builder.shuffle_vector(numbers, ir.Constant(kind, ir.Undefined), lanes)


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Eight rows of eight numbers as their eight columns, in three rounds that exchange parts of 1, 2, and 4 numbers."""
    for size in (1, 2, 4):
        low = [p if not p & size else p + LANE_COUNT - size for p in range(LANE_COUNT)]
        high = [p + size for p in low]
        masks = [ir.Constant(ir.VectorType(PLACE, LANE_COUNT), m) for m in (low, high)]
        for p in range(LANE_COUNT):
            if not p & size:
                a, b = rows[p], rows[p + size]
                rows[p], rows[p + size] = (builder.shuffle_vector(a, b, m) for m in masks)
    return rows
