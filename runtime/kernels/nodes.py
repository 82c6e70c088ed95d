"""Nodes: their eight neighbours, and the word that a search keeps of each."""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from nnpp_edge.runtime.compiled.kernel import kernel

STAMP_SHIFT = 6
OPEN_BIT = 16
UNSURE_BIT = 32
"""To be expanded; and come to by a motion that has not been checked (`kernels.lattice`)."""
ORIGIN = 8
"""Direction 0-7 leads from the parent to the node; this one marks the start."""
DIRECTION_BITS = 15
ROW_STEP = (-1, 1, 0, 0, -1, -1, 1, 1)
COL_STEP = (0, 0, -1, 1, -1, 1, -1, 1)
OPPOSITE = (1, 0, 3, 2, 7, 6, 5, 4)
"""The direction that leads back."""
DIRECTION = (4, 0, 5, 2, -1, 3, 6, 1, 7)
"""Direction of the neighbour (row, col) = (i // 3 - 1, i % 3 - 1); -1 for the cell itself."""


@kernel
def octile(row, col, goal_row, goal_col, h_straight, h_diagonal):
    """Cost of the way on an empty map whose straight and diagonal steps cost so much."""
    dr = abs(row - goal_row)
    dc = abs(col - goal_col)
    near = min(dr, dc)
    far = max(dr, dc)
    return h_diagonal * near + h_straight * (far - near)


@intrinsic
def _trailing_zeros(typing_context, value):
    def generate(context, builder, signature, arguments):
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), generate


def lowest_bit(value):
    """Number of the lowest set bit of an integer that is not 0."""
    return (int(value) & -int(value)).bit_length() - 1


@overload(lowest_bit)
def _compiled_lowest_bit(value):
    return lambda value: _trailing_zeros(value)  # type: ignore[call-arg]  # one instruction of the processor's
