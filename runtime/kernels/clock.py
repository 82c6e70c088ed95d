"""The time, for kernels that end at a deadline: they read the clock that `time.monotonic` reads."""

import time

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload


@intrinsic
def _seconds(typing_context):
    def generate(context, builder, signature, values):
        whole = ir.IntType(64)
        parts = ir.LiteralStructType((whole, whole))
        there = cgutils.alloca_once(builder, parts)
        kind = ir.FunctionType(ir.IntType(32), (ir.IntType(32), parts.as_pointer()))
        read = cgutils.get_or_insert_function(builder.module, kind, "clock_gettime")
        builder.call(read, (ir.Constant(ir.IntType(32), time.CLOCK_MONOTONIC), there))
        s, ns = (
            builder.sitofp(builder.extract_value(builder.load(there), part), ir.DoubleType())
            for part in range(2)
        )
        return builder.fadd(s, builder.fmul(ns, ir.Constant(ir.DoubleType(), 1e-9)))

    return types.float64(), generate


def late(until):
    """Whether the clock has come to `until`, in seconds; where that is inf it is not read."""
    return until < np.inf and time.monotonic() >= until


@overload(late)
def _compiled_late(until):
    return lambda until: until < np.inf and _seconds() >= until
