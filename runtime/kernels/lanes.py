"""Runs of `LANES` float32 numbers as one value, for kernels that do the same to neighbouring cells.

numba leaves it to the compiler to find out that a loop over cells may do several at once. It gives
up where arrays are many, and elsewhere asks at each start of a loop whether they overlap, which
takes longer than a short loop does. A run is a vector of LLVM: each operation on it is as many of
the processor's as its registers are narrower.

In kernels that are not compiled, runs are arrays of NumPy.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, overload, register_model, type_callable

LANES = 32


class Run(types.Type):
    """`LANES` float32 numbers."""

    vector = ir.VectorType(ir.FloatType(), LANES)


class MaskOfLanes(types.Type):
    """Which lanes of a run are meant."""

    vector = ir.VectorType(ir.IntType(1), LANES)


RUN = Run("Run")
MASK = MaskOfLanes("MaskOfLanes")


@register_model(Run)
@register_model(MaskOfLanes)
class _Vector(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, kind.vector)


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


type_callable(run_at)(lambda context: lambda array, at: RUN)
type_callable(put_run)(lambda context: lambda array, at, run: types.none)


def _place(context, builder, signature, values):
    data = context.make_array(signature.args[0])(context, builder, values[0]).data
    return builder.bitcast(builder.gep(data, [values[1]]), Run.vector.as_pointer())


@lower_builtin(run_at, types.Array, types.Integer)
def _run_at(context, builder, signature, values):
    return builder.load(_place(context, builder, signature, values), align=4)


@lower_builtin(put_run, types.Array, types.Integer, Run)
def _put_run(context, builder, signature, values):
    builder.store(values[2], _place(context, builder, signature, values), align=4)
    return context.get_dummy_value()


@overload(chosen)
def _chosen(mask, one, other):
    return None if mask is MASK else lambda mask, one, other: one if mask else other


def _spread(builder, number):
    nothing = ir.Constant(Run.vector, ir.Undefined)
    first = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(
        builder.insert_element(nothing, number, ir.IntType(32)(0)), nothing, first
    )


def _define(function, kinds, make, result=RUN):
    """Have kernels know a function of runs and masks; a float32 in a run's place is that number in
    all lanes.
    """
    taken = [()]
    for kind in kinds:
        taken = [
            (*given, each)
            for given in taken
            for each in ((RUN, types.float32) if kind is RUN else (kind,))
        ]
    taken = [
        given for given in taken if RUN in given or RUN not in kinds or MASK in given
    ]  # not numbers alone

    @infer_global(function)
    class _Known(AbstractTemplate):
        def generic(self, given, named):
            return signature(result, *given) if given in taken else None

    def compute(context, builder, signature, values):
        pairs = zip(signature.args, values, strict=True)
        return make(
            builder,
            *(_spread(builder, each) if kind is types.float32 else each for kind, each in pairs),
        )

    for given in taken:
        lower_builtin(function, *given)(compute)


def _of_llvm(name):
    def make(builder, *runs):
        kind = ir.FunctionType(Run.vector, [Run.vector] * len(runs))
        return builder.call(
            cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32"), runs
        )

    return make


for function, name in (
    (operator.add, "fadd"),
    (operator.iadd, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _define(function, (RUN, RUN), getattr(ir.IRBuilder, name))
for function, sign in ((operator.lt, "<"), (operator.gt, ">"), (operator.le, "<=")):
    _define(
        function,
        (RUN, RUN),
        lambda builder, *pair, sign=sign: builder.fcmp_ordered(sign, *pair),
        MASK,
    )
for function, name, count in (
    (fused, "fma", 3),
    (root, "sqrt", 1),
    (rounded_up, "ceil", 1),
    (abs, "fabs", 1),
):
    _define(function, (RUN,) * count, _of_llvm(name))
_define(chosen, (MASK, RUN, RUN), ir.IRBuilder.select)
_define(in_all, (types.float32,), lambda builder, number: number)
