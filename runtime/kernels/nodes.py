"""Nodes: their eight neighbours, and the word that a search keeps of each."""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import lower_builtin, type_callable
from numpy import inf, int64, uint64

from nnpp_edge.runtime.compiled.kernel import inlined, kernel

FOUND = 0
EXHAUSTED = 1
PAUSED = 2
FULL = 3
"""Why a search's kernel ended: the goal is settled, nothing is left on the open list, it is to go
on later, or the open list has no room.
"""
WITHOUT_END = (1 << 62) - 1
"""Expansions that no search comes to."""
STAMP_SHIFT = 6
LAST_STAMP = (1 << (31 - STAMP_SHIFT)) - 1
"""A word's uppermost bits are the number of the search that wrote it; and the greatest of these."""
OPEN_BIT = 16
UNSURE_BIT = 32
"""To be expanded; and come to by a motion that has not been checked (`kernels.lattice`)."""
DIRECTION_BITS = 15
ORIGIN = 15
"""Directions 0-7, or numbers of a body's primitives, lead from the parent to the node; in their
place this marks the start.
"""
ROW = 0
COL = 1
STATE = 2
"""Columns of a path; the third is of a body that drives arcs."""
ROW_STEP = (-1, 1, 0, 0, -1, -1, 1, 1)
COL_STEP = (0, 0, -1, 1, -1, 1, -1, 1)
OPPOSITE = (1, 0, 3, 2, 7, 6, 5, 4)
"""The direction that leads back."""
DIRECTION_OF = (4, 0, 5, 2, -1, 3, 6, 1, 7)
"""Direction of the neighbour (row, col) = (i // 3 - 1, i % 3 - 1); -1 for the cell itself."""


@kernel
def octile(row, col, goal_row, goal_col, h_straight, h_diagonal):
    """Cost of the way on an empty map whose straight and diagonal steps cost so much."""
    down = abs(row - goal_row)
    right = abs(col - goal_col)
    near = min(down, right)
    far = max(down, right)
    return h_diagonal * near + h_straight * (far - near)


@inlined
def rows_around(numbers, first, cols, n):
    """Numbers of the rows above, at and below `n` cells of a row, from index `first` on, and of a
    cell more at each end: a slice for each, as indices that begin at 0 need no look for negative
    ones.
    """
    above = numbers[first - cols - 1 : first - cols + n + 1]
    below = numbers[first + cols - 1 : first + cols + n + 1]
    return above, numbers[first - 1 : first + n + 1], below


@inlined
def neighbour(node, k, stride):
    """The node to which a step in direction k leads."""
    return node + ROW_STEP[k] * stride + COL_STEP[k]


@inlined
def beside_wall(weights, node, down, right):
    """Whether a diagonal step passes beside an impassable cell: so many nodes down, and right."""
    above = weights[uint64(node + down)] == inf
    return above | (weights[uint64(node + right)] == inf)


@inlined
def step_cost(diagonal, pair, terms):
    """Cost of a step between nodes whose weights sum to `pair`, by `StepTerms`."""
    length = terms.length_diagonal if diagonal else terms.length_straight
    weight = terms.weight_diagonal if diagonal else terms.weight_straight
    return length + weight * pair


@inlined
def g_of(g, node):
    """g of a node that the search has come to."""
    return g[uint64(2 * node)]


@inlined
def word_of(meta, node):
    """The word of a node: the number of the search that wrote it, flags, and a direction."""
    return int64(meta[uint64(2 * node + 1)])


@inlined
def put_word(meta, node, word):
    """Write the word of a node."""
    meta[uint64(2 * node + 1)] = word


@inlined
def visit(memory, node, g, word):
    """Come to a node: write its g, and its word with the number of the search."""
    memory.g[uint64(2 * node)] = g
    put_word(memory.meta, node, (memory.stamp << STAMP_SHIFT) | word)


@kernel
def next_stamp(meta):
    """Begin another search in its memory, whose number this is; all nodes read as unvisited."""
    number = meta[0] + 1
    if number > LAST_STAMP:
        meta[1::2] = 0
        number = 1
    meta[0] = number
    return number


@inlined
def outside(region, row, col):
    """Whether a region lacks a cell, numbered within the border."""
    i = uint64(region.row_block[uint64(row - 1)])
    j = uint64(region.col_block[uint64(col - 1)])
    return region.bitmap[i, j] != region.stamp


def lowest_bit(value):
    """Number of the lowest set bit of an integer that is not 0."""
    return (int(value) & -int(value)).bit_length() - 1


type_callable(lowest_bit)(lambda context: lambda value: types.int64)


@lower_builtin(lowest_bit, types.int64)
def _lowest_bit(context, builder, signature, values):
    """One instruction of the processor's."""
    return builder.cttz(values[0], ir.Constant(ir.IntType(1), 1))


def prefetch(numbers, index):
    """Have the processor fetch a number of an array, which is read soon."""


type_callable(prefetch)(lambda context: lambda numbers, index: types.none)


@lower_builtin(prefetch, types.Array, types.Integer)
def _prefetch(context, builder, signature, values):
    """One instruction, that no address makes fail."""
    kind, _ = signature.args
    array = cgutils.create_struct_proxy(kind)(context, builder, value=values[0])
    byte = ir.IntType(8).as_pointer()
    word = ir.IntType(32)
    instruction = ir.FunctionType(ir.VoidType(), (byte, word, word, word))
    fetch = builder.module.declare_intrinsic("llvm.prefetch", (byte,), instruction)
    place = builder.bitcast(builder.gep(array.data, [values[1]]), byte)
    # to be read, kept near, and data, not code
    how = (ir.Constant(word, number) for number in (0, 3, 1))
    builder.call(fetch, (place, *how))
    return context.get_dummy_value()


@inlined
def fetch_around(numbers, each, node, stride):
    """Fetch the rows above and below a node that is put on an open list, so that they are there
    when it is expanded: memory takes as long to answer as ten expansions do. `each` numbers belong
    to a node.
    """
    prefetch(numbers, each * (node - stride))
    prefetch(numbers, each * (node + stride))
