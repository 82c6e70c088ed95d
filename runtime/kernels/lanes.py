"""Runs of `LANES` float32 numbers as one value, for kernels that do the same to neighbouring cells.

numba leaves it to the compiler to find out that a loop over cells may do several at once. It gives up where arrays
are many, and elsewhere asks at each start of a loop whether they overlap, which takes longer than a short loop does.
A run is a vector of LLVM: each operation on it is as many of the processor's as its registers are narrower.

In kernels that are not compiled, runs are arrays of NumPy.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

LANES = 32


class Run(types.Type):
    """`LANES` float32 numbers."""

    def __init__(self):
        super().__init__("Run")


class Mask(types.Type):
    """Which lanes of a run are meant."""

    def __init__(self):
        super().__init__("Mask")


RUN, MASK = Run(), Mask()
_NUMBERS, _BITS = ir.VectorType(ir.FloatType(), LANES), ir.VectorType(ir.IntType(1), LANES)


@register_model(Run)
class _RunModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _NUMBERS)


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _BITS)


def run_at(array, at):
    """The run of a float32 array that begins at a place."""
    return array[at : at + LANES].copy()


def put_run(array, at, run):
    """Write a run into a float32 array, from a place on."""
    array[at : at + LANES] = run


def in_all(number):
    """One float32 number in all lanes."""
    return np.full(LANES, number, np.float32)


def chosen(mask, one, other):
    """`one` where the mask holds, else `other`: of runs lane by lane, and of numbers."""
    return np.where(mask, one, other)


def root(run):
    """Square roots, lane by lane."""
    return np.sqrt(run)


def rounded_up(run):
    """The least whole numbers that are not less."""
    return np.ceil(run)


def fused(factor, run, more):
    """`factor` times a run, and another run more, rounded once: a processor's one instruction."""
    return factor * run + more


@intrinsic
def _run_at(typing_context, array, at):
    def generate(context, builder, signature, values):
        data = context.make_array(signature.args[0])(context, builder, values[0]).data
        place = builder.bitcast(builder.gep(data, [values[1]]), _NUMBERS.as_pointer())
        return builder.load(place, align=4)

    return RUN(array, types.intp), generate


@overload(run_at)
def _compiled_run_at(array, at):
    return lambda array, at: _run_at(array, at)


@intrinsic
def _put_run(typing_context, array, at, run):
    def generate(context, builder, signature, values):
        data = context.make_array(signature.args[0])(context, builder, values[0]).data
        place = builder.bitcast(builder.gep(data, [values[1]]), _NUMBERS.as_pointer())
        builder.store(values[2], place, align=4)
        return context.get_dummy_value()

    return types.none(array, types.intp, run), generate


@overload(put_run)
def _compiled_put_run(array, at, run):
    return lambda array, at, run: _put_run(array, at, run)


def _spread(builder, number):
    nothing = ir.Constant(_NUMBERS, ir.Undefined)
    first = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(builder.insert_element(nothing, number, ir.IntType(32)(0)), nothing, first)


@intrinsic
def _in_all(typing_context, number):
    def generate(context, builder, signature, values):
        return _spread(builder, values[0])

    return RUN(types.float32), generate


@overload(in_all)
def _compiled_in_all(number):
    return lambda number: _in_all(np.float32(number))


def _define_pairwise(function, result, make):
    """Have kernels know an operator of two runs, or of a run and a float32."""

    @intrinsic
    def compute(typing_context, one, other):
        def generate(context, builder, signature, values):
            pairs = zip(signature.args, values, strict=True)
            return make(builder, *(each if kind is RUN else _spread(builder, each) for kind, each in pairs))

        return result(*(RUN if kind is RUN else types.float32 for kind in (one, other))), generate

    @overload(function)
    def compiled(one, other):
        if RUN in (one, other) and {one, other} <= {RUN, types.float32}:
            return lambda one, other: compute(one, other)
        return None


def _comparison(sign):
    return lambda builder, one, other: builder.fcmp_ordered(sign, one, other)


for sign in operator.add, operator.iadd:
    _define_pairwise(sign, RUN, lambda builder, one, other: builder.fadd(one, other))
_define_pairwise(operator.sub, RUN, lambda builder, one, other: builder.fsub(one, other))
_define_pairwise(operator.mul, RUN, lambda builder, one, other: builder.fmul(one, other))
_define_pairwise(operator.truediv, RUN, lambda builder, one, other: builder.fdiv(one, other))
_define_pairwise(operator.lt, MASK, _comparison("<"))
_define_pairwise(operator.gt, MASK, _comparison(">"))
_define_pairwise(operator.le, MASK, _comparison("<="))


@intrinsic
def _both(typing_context, one, other):
    return MASK(MASK, MASK), lambda context, builder, signature, values: builder.and_(*values)


@overload(operator.and_)
@overload(operator.iand)
def _compiled_both(one, other):
    return (lambda one, other: _both(one, other)) if (one, other) == (MASK, MASK) else None


@intrinsic
def _chosen(typing_context, mask, one, other):
    def generate(context, builder, signature, values):
        kinds = signature.args[1:]
        runs = (
            value if kind is RUN else _spread(builder, value) for kind, value in zip(kinds, values[1:], strict=True)
        )
        return builder.select(values[0], *runs)

    return RUN(MASK, *(RUN if kind is RUN else types.float32 for kind in (one, other))), generate


@overload(chosen)
def _compiled_chosen(mask, one, other):
    if mask is MASK:
        return lambda mask, one, other: _chosen(mask, one, other)
    return lambda mask, one, other: one if mask else other


def _define_single(function, name):
    """Have kernels know a function of a run, by its name in LLVM."""

    @intrinsic
    def compute(typing_context, run):
        def generate(context, builder, signature, values):
            kind = ir.FunctionType(_NUMBERS, [_NUMBERS])
            there = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32")
            return builder.call(there, values)

        return RUN(RUN), generate

    @overload(function)
    def compiled(run):
        return (lambda run: compute(run)) if run is RUN else None


@intrinsic
def _fused(typing_context, factor, run, more):
    def generate(context, builder, signature, values):
        kind = ir.FunctionType(_NUMBERS, [_NUMBERS] * 3)
        there = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{LANES}f32")
        return builder.call(there, (_spread(builder, values[0]), *values[1:]))

    return RUN(types.float32, RUN, RUN), generate


@overload(fused)
def _compiled_fused(factor, run, more):
    return lambda factor, run, more: _fused(np.float32(factor), run, more)


_define_single(root, "sqrt")
_define_single(rounded_up, "ceil")
_define_single(abs, "fabs")
