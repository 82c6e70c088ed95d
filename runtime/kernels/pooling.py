"""Coarse levels of a map: their weights, the connected pieces under their cells, and which
neighbours those touch.

See `map.pyramid` for what a level stands for.
"""

import numpy as np
from numpy import float32, float64, inf, int64, uint8, uint16, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.nodes import (
    COL_STEP,
    DIRECTION_OF,
    ROW_STEP,
    beside_wall,
    lowest_bit,
    neighbour,
    rows_around,
)
from nnpp_edge.runtime.kernels.records import Area, LevelRecord

NO_AREA = Area(1 << 31, 0, 1 << 31, 0)
"""That holds no cell."""
FACTOR = 4
"""Cells of a level to the side of a cell of the next coarser one."""
CELLS_BELOW = FACTOR * FACTOR
"""Cells under a coarse cell."""
WHOLE = (1 << CELLS_BELOW) - 1
"""The piece of a coarse cell that is passable all over."""
NO_PIECES = np.empty(0, uint16)
NO_LINKS = np.empty(0, uint8)
"""Of a level where passability decides."""
_FIRST_ROW = (1 << FACTOR) - 1
_FIRST_COL = WHOLE // _FIRST_ROW
_LAST_COL = _FIRST_COL << FACTOR - 1
_TO_LAST_ROW = FACTOR * (FACTOR - 1)
_TO_LAST_COL = FACTOR - 1
_WHOLE = uint16(WHOLE)
_EVERY_WAY = uint8(255)
_SIXTEENTH = float32(1 / 16)
_1 = uint64(1)
_2 = uint64(2)
_3 = uint64(3)


# Pieces


@helper
def _spread(piece, diagonally):
    """A set of a coarse cell's 16 cells, as bits row by row, and their neighbours within it."""
    beside = piece | (piece & ~_LAST_COL) << 1 | (piece & ~_FIRST_COL) >> 1
    above_and_below = beside if diagonally else piece
    return (beside | above_and_below << FACTOR | above_and_below >> FACTOR) & WHOLE


@helper
def _connected(first, passable, diagonally):
    """The passable cells that are connected with one, where passability alone decides.

    A diagonal step that may not cut corners joins no cells that straight steps do not.
    """
    piece = first
    before = 0
    while piece != before:
        before = piece
        piece = _spread(piece, diagonally) & passable
    return piece


@helper
def _linked(first, passable, finer, row, col):
    """The passable cells under a coarse cell that links lead to from one."""
    piece = 0
    frontier = first
    while frontier:
        bit = frontier & -frontier
        frontier ^= bit
        piece |= bit
        at = lowest_bit(bit)
        node = _node_below(row, col, at, finer.stride)
        for k in range(8):
            i = at // FACTOR + ROW_STEP[k]
            j = at % FACTOR + COL_STEP[k]
            if 0 <= i < FACTOR and 0 <= j < FACTOR:
                other = 1 << (i * FACTOR + j)
                fresh = other & passable and not other & (piece | frontier)
                if fresh and (finer.links[node] >> k) & 1:
                    frontier |= other
    return piece


@inlined
def _node_below(row, col, at, stride):
    """Node of a coarse cell's cell number `at`, on the finer level."""
    return (row * FACTOR + at // FACTOR + 1) * stride + col * FACTOR + at % FACTOR + 1


@inlined
def _is_on_map(row, col, at, finer):
    """Whether a coarse cell's cell number `at` lies on the map."""
    below = row * FACTOR + at // FACTOR < finer.rows
    return below and col * FACTOR + at % FACTOR < finer.cols


@inlined
def _size(piece):
    """Number of cells of a piece."""
    size = 0
    while piece:
        piece &= piece - 1
        size += 1
    return size


@helper
def _largest_piece(finer, row, col, corner_cutting):
    """The largest connected piece of the passable cells under a coarse cell, as 16 bits, row by
    row.
    """
    passable = 0
    for at in range(CELLS_BELOW):
        if _is_on_map(row, col, at, finer):
            node = _node_below(row, col, at, finer.stride)
            passable |= int64(finer.weights[node] != inf) << at
    by_links = len(finer.links) > 0
    if passable == WHOLE and not by_links:
        return passable
    best = 0
    best_size = 0
    while passable:
        first = passable & -passable
        if by_links:
            piece = _linked(first, passable, finer, row, col)
        else:
            piece = _connected(first, passable, corner_cutting)
        passable &= ~piece
        size = _size(piece)
        if size > best_size:
            best = piece
            best_size = size
    return best


# Weights


@helper
def _pool_row(fine, first, stride, n, out):
    """Means of `n` coarse cells that cover sixteen cells each, the first of which begin
    at `first`.
    """
    wide = FACTOR * n
    r0 = fine[first : first + wide]
    r1 = fine[first + stride : first + stride + wide]
    first += 2 * stride
    r2 = fine[first : first + wide]
    r3 = fine[first + stride : first + stride + wide]
    for col in range(n):
        c = uint64(FACTOR * col)
        at1 = c + _1
        at2 = c + _2
        at3 = c + _3
        c0 = r0[c] + r1[c] + r2[c] + r3[c]
        c1 = r0[at1] + r1[at1] + r2[at1] + r3[at1]
        c2 = r0[at2] + r1[at2] + r2[at2] + r3[at2]
        c3 = r0[at3] + r1[at3] + r2[at3] + r3[at3]
        out[col] = ((c0 + c1) + (c2 + c3)) * _SIXTEENTH


@helper
def _common_below(fine, row, col, stride):
    """The bits that the sixteen cells under a coarse cell, none of which may lie off the map, have
    in common.

    Of pieces: all where every piece is whole, and such cells are linked with one another. Of links:
    all where all leave each of them.
    """
    first = uint64(_node_below(row, col, 0, stride))
    common = fine[first]
    for i in range(FACTOR):
        at = first + uint64(i * stride)
        first_two = fine[at] & fine[at + _1]
        common &= first_two & fine[at + _2] & fine[at + _3]
    return common


@helper
def _pool_cell(finer, row, col, corner_cutting, obstacle):
    """The piece that a coarse cell stands for, and its weight."""
    piece = _largest_piece(finer, row, col, corner_cutting)
    if piece == 0:
        return piece, float32(inf)
    total = 0.0
    cells = 0
    for at in range(CELLS_BELOW):
        if _is_on_map(row, col, at, finer):
            cells += 1
            weight = obstacle
            if (piece >> at) & 1:
                weight = float64(finer.weights[_node_below(row, col, at, finer.stride)])
            total += weight
    return piece, float32(total / cells)


@helper
def pool(finer, corner_cutting, obstacle, area, coarse):
    """Weights and pieces of a rectangle of coarse cells; the least weight. As `pool_and_link`,
    without the links.

    Of the finer level's links those are read that lie within a coarse cell whose pieces are not all
    whole.
    """
    weights = coarse.weights
    least = float32(inf)
    # from here on coarse cells stick out of the map
    whole = max(min(area.col1, finer.cols // FACTOR), area.col0)
    for row in range(area.row0, area.row1):
        at = (row + 1) * coarse.stride + 1
        averaged = whole if row < finer.rows // FACTOR else area.col0
        if averaged > area.col0:
            first = _node_below(row, area.col0, 0, finer.stride)
            out = weights[at + area.col0 : at + averaged]
            _pool_row(finer.weights, first, finer.stride, averaged - area.col0, out)
        for col in range(area.col0, area.col1):
            whole_piece = col < averaged and weights[at + col] < inf
            if whole_piece and len(finer.pieces):
                whole_piece = _common_below(finer.pieces, row, col, finer.stride) == _WHOLE
            if whole_piece:
                coarse.pieces[at + col] = WHOLE
            else:
                piece, weight = _pool_cell(finer, row, col, corner_cutting, obstacle)
                coarse.pieces[at + col] = piece
                if piece != WHOLE:  # else the mean is there, rounded as that of any such cell
                    weights[at + col] = weight
            least = min(least, weights[at + col])
    return float64(least)


# Links


@helper
def _touches(finer, row, col, here, there, k, corner_cutting):
    """Whether a step leads from a coarse cell's piece into that of its neighbour in direction k,
    where passability alone decides.
    """
    down = ROW_STEP[k]
    right = COL_STEP[k]
    if down == 0 or right == 0:
        # of both pieces, the row or the column where the two coarse cells meet
        first = _FIRST_ROW if right == 0 else _FIRST_COL
        to_last = _TO_LAST_ROW if right == 0 else _TO_LAST_COL
        backwards = down + right < 0
        edge = (here if backwards else here >> to_last) & first
        other = there >> to_last if backwards else there
        if corner_cutting:
            edge = _spread(edge, False)
        return edge & other & first != 0
    i = 0 if down < 0 else FACTOR - 1
    j = 0 if right < 0 else FACTOR - 1
    corner = i * FACTOR + j
    across = CELLS_BELOW - 1 - corner
    if not (here >> corner) & (there >> across) & 1:
        return False
    node = _node_below(row, col, corner, finer.stride)
    return corner_cutting or not beside_wall(finer.weights, node, down * finer.stride, right)


@helper
def _touched(finer, row, col, corner_cutting, coarse):
    """The directions, as bits, in which a coarse cell's piece touches a neighbour's, where
    passability alone decides.
    """
    node = (row + 1) * coarse.stride + col + 1
    here = int64(coarse.pieces[node])
    found = 0
    for k in range(8):
        there = int64(coarse.pieces[neighbour(node, k, coarse.stride)])
        if here and there and _touches(finer, row, col, here, there, k, corner_cutting):
            found |= 1 << k
    return found


@helper
def _touched_by_links(finer, row, col, coarse):
    """The same, where the finer level's links decide."""
    here = (row + 1) * coarse.stride + col + 1
    piece = int64(coarse.pieces[here])
    found = 0
    for at in range(CELLS_BELOW):
        r = at // FACTOR
        c = at % FACTOR
        inner = 0 < r < FACTOR - 1 and 0 < c < FACTOR - 1
        if inner or not (piece >> at) & 1:
            continue
        node = _node_below(row, col, at, finer.stride)
        for k in range(8):
            i = r + ROW_STEP[k]
            j = c + COL_STEP[k]
            down = (i >= 0) - 1 + (i >= FACTOR)
            right = (j >= 0) - 1 + (j >= FACTOR)
            if down == 0 and right == 0:
                continue
            towards = DIRECTION_OF[(down + 1) * 3 + right + 1]
            if (found >> towards) & 1:
                continue
            other = int64(coarse.pieces[here + down * coarse.stride + right])
            there = (i - down * FACTOR) * FACTOR + j - right * FACTOR
            if (other >> there) & 1 and (finer.links[node] >> k) & 1:
                found |= 1 << towards
    return found


@helper
def _link_free_row(pieces, first, stride, n, links):
    """All links of those of `n` coarse cells in and beside which no impassable cell lies; none of
    the others.
    """
    above, beside, below = rows_around(pieces, first, stride, n)
    out = links[first : first + n]
    for c in range(n):
        left = uint64(c)
        mid = left + _1
        right = left + _2
        every = above[left] & above[mid] & above[right]
        every &= beside[left] & beside[mid] & beside[right]
        every &= below[left] & below[mid] & below[right]
        out[c] = _EVERY_WAY if every == _WHOLE else uint8(0)


@helper
def link(finer, corner_cutting, area, coarse):
    """Links of a rectangle of coarse cells. As `pool_and_link`, whose pieces are up to date."""
    stride = coarse.stride
    by_links = len(finer.links) > 0
    for row in range(area.row0, area.row1):
        first = (row + 1) * stride + area.col0 + 1
        _link_free_row(coarse.pieces, first, stride, area.col1 - area.col0, coarse.links)
        for col in range(area.col0, area.col1):
            node = (row + 1) * stride + col + 1
            free = coarse.links[node] != 0
            if free and by_links:  # whether no passage to a neighbour is closed
                free = _common_below(finer.links, row, col, finer.stride) == _EVERY_WAY
            if free:
                continue
            if by_links:
                coarse.links[node] = _touched_by_links(finer, row, col, coarse)
            else:
                coarse.links[node] = _touched(finer, row, col, corner_cutting, coarse)


@kernel
def pool_and_link(finer: LevelRecord, corner_cutting, obstacle, area: Area, coarse: LevelRecord):
    """Bring a rectangle of coarse cells up to date with the finer level, and the links of the cells
    around it.

    Parameters
    ----------
    finer, coarse
        The finer level, whose pieces and links are empty where passability decides, and the coarse
        one, written.
    corner_cutting : bool
        Whether a diagonal step of the finest level may pass an impassable cell.
    obstacle : float
        What an impassable cell counts for in a mean.
    area
        `Area` of coarse cells.

    Returns
    -------
    float
        The least weight in the rectangle.
    """
    least = pool(finer, corner_cutting, obstacle, area, coarse)
    link(finer, corner_cutting, around(area, coarse, 1), coarse)
    return least


@inlined
def around(area, level, rim):
    """A rectangle of cells of a level, or of the map, and so many around it."""
    row0 = max(area.row0 - rim, 0)
    row1 = min(area.row1 + rim, level.rows)
    col0 = max(area.col0 - rim, 0)
    col1 = min(area.col1 + rim, level.cols)
    return Area(row0, row1, col0, col1)


@inlined
def with_cell(area, row, col):
    """The rectangle that holds another and a cell."""
    row0 = min(area.row0, row)
    row1 = max(area.row1, row + 1)
    return Area(row0, row1, min(area.col0, col), max(area.col1, col + 1))


@inlined
def in_units(area, high, wide):
    """The units of so many rows and columns in which cells of a rectangle lie."""
    row1 = (area.row1 - 1) // high + 1
    return Area(area.row0 // high, row1, area.col0 // wide, (area.col1 - 1) // wide + 1)


@inlined
def above(area):
    """The coarse cells above a rectangle."""
    return in_units(area, FACTOR, FACTOR)
