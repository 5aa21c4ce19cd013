"""Sums of products in registers, for compiled code. LLVM does not find this optimisation in numba's loops by itself.

A tile of sums is `ROWS` by `WIDTH` numbers, which fill most of the processor's registers. Each step multiplies one
number of every row by `WIDTH` numbers that all rows share. So a step loads few numbers for many products, as the fast
matrix products of BLAS libraries do.
"""

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.extending import intrinsic

_TARGET: Any = cpu_target.target_context
_AVX512 = "+avx512f" in _TARGET.codegen().magic_tuple()[2]  # numba's cache of machine code depends on it, too
LANES = 16 if _AVX512 else 8
"""fp32 numbers in a register."""
ROWS = 12 if _AVX512 else 6
"""With two registers per row, these rows fill most of the 32 registers of AVX-512, or of the 16 of AVX2."""
WIDTH = 2 * LANES
_FLOAT, _INDEX = ir.FloatType(), ir.IntType(64)
_VECTOR = ir.VectorType(_FLOAT, LANES)


class _Code:
    """Writes LLVM instructions for vectors of fp32 numbers in arrays."""

    def __init__(self, context: Any, builder: Any, signature: Any, values: Any) -> None:
        self.context, self.builder, self.types = context, builder, signature.args
        self.values = values

    def data(self, argument: int) -> Any:
        """Pointer to the first number of an array argument."""
        return self.context.make_array(self.types[argument])(self.context, self.builder, self.values[argument]).data

    def at(self, pointer: Any, *offsets: Any) -> Any:
        """Pointer to a number at some offset."""
        for offset in offsets:
            pointer = self.builder.gep(pointer, [offset if isinstance(offset, ir.Value) else _INDEX(offset)])
        return pointer

    def load(self, pointer: Any) -> Any:
        """Load two consecutive vectors from memory."""
        vectors = self.builder.bitcast(pointer, _VECTOR.as_pointer())
        return [self.builder.load(self.at(vectors, i), align=4) for i in range(2)]

    def store(self, pair: Any, pointer: Any) -> None:
        """Store two consecutive vectors to memory."""
        vectors = self.builder.bitcast(pointer, _VECTOR.as_pointer())
        for i, vector in enumerate(pair):
            self.builder.store(vector, self.at(vectors, i), align=4)

    def spread(self, number: Any) -> Any:
        """A vector that holds a number in every lane."""
        one = self.builder.insert_element(_VECTOR(ir.Undefined), number, ir.IntType(32)(0))
        lanes = ir.VectorType(ir.IntType(32), LANES)([0] * LANES)
        return self.builder.shuffle_vector(one, _VECTOR(ir.Undefined), lanes)

    def variables(self, pair: Any) -> Any:
        """Two variables, which LLVM keeps in registers."""
        return [cgutils.alloca_once_value(self.builder, vector) for vector in pair]

    def add_product(self, number: Any, pair: Any, to: Any) -> None:
        """`to += number · pair`, with one rounding if the processor has an instruction for it."""
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        multiply_add = cgutils.get_or_insert_function(self.builder.module, kind, f"llvm.fmuladd.v{LANES}f32")
        factor = self.spread(number)
        for vector, variable in zip(pair, to, strict=True):
            self.builder.store(self.builder.call(multiply_add, [factor, vector, self.builder.load(variable)]), variable)


def _add_rows(  # noqa: PLR0917  # compiled code takes arguments by position
    _: Any, rows: Any, x: Any, _x_at: Any, x_places: Any, _place: Any, _taps: Any, _x_step: Any, _run: Any,
    b: Any, _b_at: Any, _b_step: Any, start: Any, _start_at: Any, _start_step: Any,
    to: Any, _to_at: Any, to_places: Any, _slope: Any,
) -> Any:  # fmt: skip
    n = types.intp
    signature = types.void(
        rows, x, n, x_places, n, n, n, n, b, n, n, start, n, n, to, n, to_places, types.float32
    )  # fmt: skip

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = _Code(context, builder, signature, values)
        _, _, x_at, _, place, taps, x_step, run, _, b_at, b_step, _, start_at, start_step, _, to_at, _, slope = values
        x, b = code.at(code.data(1), x_at), code.at(code.data(8), b_at)
        start, to = code.at(code.data(11), start_at), code.at(code.data(14), to_at)
        of_x, of_to = code.at(code.data(3), place), code.at(code.data(16), place)
        inputs = [code.at(x, builder.load(code.at(of_x, i))) for i in range(rows.literal_value)]
        makes = [builder.load(code.at(of_to, i)) for i in range(rows.literal_value)]
        sums = [code.variables(code.load(code.at(start, builder.mul(begins, start_step)))) for begins in makes]
        with cgutils.for_range(builder, taps) as outer:
            x_from, b_from = builder.mul(outer.index, x_step), builder.mul(outer.index, run)
            with cgutils.for_range(builder, run) as inner:
                pair = code.load(code.at(b, builder.mul(builder.add(b_from, inner.index), b_step)))
                for one, total in zip(inputs, sums, strict=True):
                    code.add_product(builder.load(code.at(one, x_from, inner.index)), pair, total)
        below = code.spread(slope)
        for begins, total in zip(makes, sums, strict=True):
            pair = [builder.load(variable) for variable in total]
            above = [builder.fcmp_ordered(">", one, _VECTOR([_FLOAT(0)] * LANES)) for one in pair]
            active = [builder.select(yes, one, builder.fmul(one, below)) for yes, one in zip(above, pair, strict=True)]
            code.store(active, code.at(to, begins))
        return context.get_dummy_value()

    return signature, generate


def _add_columns(
    _: Any, rows: Any, x: Any, _x_at: Any, x_places: Any, _count: Any,
    y: Any, _y_at: Any, _width: Any, to: Any, _to_at: Any,
) -> Any:  # fmt: skip
    n = types.intp
    signature = types.void(rows, x, n, x_places, n, y, n, n, to, n)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = _Code(context, builder, signature, values)
        _, _, x_at, _, count, _, y_at, width, _, to_at = values
        x, y, to = code.at(code.data(1), x_at), code.at(code.data(5), y_at), code.at(code.data(8), to_at)
        places = code.data(3)
        makes = [code.at(to, builder.mul(_INDEX(i), width)) for i in range(rows.literal_value)]
        sums = [code.variables(code.load(one)) for one in makes]
        with cgutils.for_range(builder, count) as loop:
            pair = code.load(code.at(y, builder.mul(loop.index, width)))
            looked = code.at(x, builder.load(code.at(places, loop.index)))
            for i, total in enumerate(sums):
                code.add_product(builder.load(code.at(looked, i)), pair, total)
        for one, total in zip(makes, sums, strict=True):
            code.store([builder.load(variable) for variable in total], one)
        return context.get_dummy_value()

    return signature, generate


add_rows = cast("Callable[..., None]", intrinsic(prefer_literal=True)(_add_rows))
"""In compiled code: compute a tile of `rows` places by `WIDTH` numbers.

    to[to_at + to_places[place + i] + k] = activation(
        start[start_at + start_step · to_places[place + i] + k]
        + Σ_tap Σ_r x[x_at + x_places[place + i] + tap · x_step + r] · b[b_at + (tap · run + r) · b_step + k])

Arguments: rows (a constant), x, x_at, x_places, place, taps, x_step, run, b, b_at, b_step, start, start_at, start_step,
to, to_at, to_places, slope. A sum starts at a bias if `start_step` is 0, or at the present value if it is 1. Numbers
below zero are multiplied by the slope: 0 for a ReLU, 1 for no activation.
"""
add_columns = cast("Callable[..., None]", intrinsic(prefer_literal=True)(_add_columns))
"""In compiled code: add to a tile of `rows` by `WIDTH` sums over places.

    to[to_at + i · width + k] += Σ_place x[x_at + x_places[place] + i] · y[y_at + place · width + k]

Arguments: rows (a constant), x, x_at, x_places, count of places, y, y_at, width, to, to_at.
"""
