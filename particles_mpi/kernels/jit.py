"""How kernels are compiled: `@kernel` those that Python calls, `@inner` those that only kernels call, `@lean` as one of both.

All are kept in numba's cache. Without numba's entries for C, and for Python where only kernels call, a small kernel compiles in
two thirds of the time. Called from Python an `@inner` kernel runs uncompiled.

`@lean` kernels count no references, which numba does with locked instructions wherever a function unpacks a tuple of arrays or
takes a part of one: half of the time of a kernel that does little a call. Such a function cannot make an array.

`@in_place` ones, and `@lean_in_place`, which Python calls too, become part of the kernel that calls them. A call hands over seven
numbers for each array of a bundle, which takes up to 0.1 us: more than most small functions.

Every combination of argument types is compiled for itself, which takes a tenth of a second to several. A tuple `axes`, whose
length is the dimension, makes one for each dimension: only kernels that take much of a run's time have it. A literal number as
an argument makes another one, and so does a variable that starts as a literal: `count = np.int64(0)` if it is handed on.
"""

from functools import partial
from typing import Any

from llvmlite import ir
from numba import extending, njit, types
from numba.core import cgutils
from numba.core.registry import CPUDispatcher
from numba.cpython.unsafe.numbers import trailing_zeros as count_trailing_zeros
from numba.cpython.unsafe.tuple import tuple_setitem

from particles_mpi.kernels.loading import load_and_keep_kernels

load_and_keep_kernels()
kernel: Any = partial(njit, cache=True, no_cfunc_wrapper=True)
lean: Any = kernel(_nrt=False)
intrinsic: Any = extending.intrinsic  # whose own types say that it is called as it is written, `typing` included


class Inner(CPUDispatcher):
    """A compiled function without an entry for Python, which would otherwise jump to nowhere."""

    def __call__(self, *args: Any) -> Any:
        return self.py_func(*args)


def inner(function: Any = None, **options: Any) -> Any:
    """Compile a function that only kernels call."""
    if function is None:
        return partial(inner, **options)
    compiled = kernel(no_cpython_wrapper=True, **options)(function)
    if isinstance(compiled, CPUDispatcher):  # not with NUMBA_DISABLE_JIT
        compiled.__class__ = Inner
    return compiled


lean_inner: Any = inner(_nrt=False)
in_place: Any = inner(_nrt=False, forceinline=True)
lean_in_place: Any = kernel(_nrt=False, forceinline=True)
screening: Any = inner(_nrt=False, forceinline=True, fastmath={"contract"})  # what it lets pass must be tested exactly
trailing_zeros: Any = count_trailing_zeros  # of an integer that is not 0
with_item: Any = tuple_setitem  # (tuple, place, value): sums in a tuple stay in registers, those in an array do not


def plain(bundle: tuple[Any, ...]) -> tuple[Any, ...]:
    """A NamedTuple as plain tuples, those in it too: for kernels that Python calls many times a step, and that unpack them first.

    Numba finds out the types of its arguments in every call: in 0.3 us for each array of a NamedTuple, three times as long.
    """
    return tuple(plain(part) if isinstance(part, tuple) else part for part in bundle)


@intrinsic
def prefetch(typing: Any, array: Any, row: Any) -> Any:
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


def repeated(builder: Any, value: Any, count: int) -> Any:
    """A vector of the compiler's with one number in all places."""
    place = ir.IntType(32)
    empty = ir.Constant(ir.VectorType(value.type, count), ir.Undefined)
    one = builder.insert_element(empty, value, ir.Constant(place, 0))
    return builder.shuffle_vector(one, empty, ir.Constant(ir.VectorType(place, count), [0] * count))


@intrinsic
def spheres_within(typing: Any, axes: Any, middle: Any, own: Any, limit: Any, spheres: Any, first: Any) -> Any:
    """Which of eight spheres are within reach of one: bit p for sphere first + p, as int64.

    middle (g,) and own: place and radius of the one. spheres (n, 4): g coordinates, and last the radius, all float32. g: the
    number of axes, at most 3. Radii above limit are out of reach. Vectors of eight on every processor: the same bits.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        float32, number = ir.FloatType(), ir.IntType(64)
        one, all_ = (context.make_array(signature.args[k])(context, builder, arguments[k]) for k in (1, 4))

        address = cgutils.get_item_pointer(
            context, builder, signature.args[4], all_, [arguments[5], ir.Constant(number, 0)], wraparound=False
        )
        together = ir.VectorType(float32, 32)
        spheres = builder.load(builder.bitcast(address, together.as_pointer()), align=4)

        def column(k: int) -> Any:
            """Column k of the eight rows of `spheres`."""
            places = [4 * sphere + k for sphere in range(8)]
            return builder.shuffle_vector(
                spheres, ir.Constant(together, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), 8), places)
            )

        g = min(len(signature.args[0]), 3)
        square = None
        for k in range(g):
            place = [ir.Constant(number, k)]
            address = cgutils.get_item_pointer(context, builder, signature.args[1], one, place, wraparound=False)
            r = builder.fsub(repeated(builder, builder.load(address), 8), column(k))
            square = builder.fmul(r, r) if square is None else builder.fadd(square, builder.fmul(r, r))
        radii = column(3)
        reach = builder.fadd(repeated(builder, arguments[2], 8), radii)
        within = builder.fcmp_ordered("<=", square, builder.fmul(reach, reach))
        small = builder.fcmp_ordered("<=", radii, repeated(builder, arguments[3], 8))
        return builder.zext(builder.bitcast(builder.and_(within, small), ir.IntType(8)), number)

    return types.int64(axes, middle, own, limit, spheres, first), generate


@intrinsic
def fma(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c, rounded once, on every processor: those that have no instruction for it take a hundred times as long."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = arguments[0].type
        if not isinstance(kind, ir.VectorType):
            return builder.fma(*arguments)
        name = f"llvm.fma.v{kind.count}{kind.element.intrinsic_name}"
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind] * 3), name)
        return builder.call(function, arguments)

    return a(a, a, a), generate


@intrinsic
def as_kind(typing: Any, value: Any, other: Any) -> Any:
    """The value as a number of the kind of another one: numba takes a literal for a float64, and what comes of it too."""
    kind = types.unliteral(other)
    return kind(value, other), lambda context, builder, signature, arguments: context.cast(builder, arguments[0], value, kind)


@intrinsic
def wide(typing: Any) -> Any:
    """The kernel that calls this may use the longest vectors, and may take it that no two of its arrays have memory in common.

    By itself the compiler uses vectors of half the length where these were faster on older processors, and examines the places
    of all arrays before it uses any, which takes longer than a short loop.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')  # llvmlite itself knows no attributes with values
        for argument in builder.function.args:
            if isinstance(argument.type, ir.PointerType):
                argument.add_attribute("noalias")
        return context.get_dummy_value()

    return types.void(), generate
