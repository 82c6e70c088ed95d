"""Coarse levels of a map: their weights, the connected pieces under their cells, and which
neighbours those touch.

See `map.pyramid` for what a level stands for.
"""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.nodes import COL_STEP, DIRECTION_OF, ROW_STEP, lowest_bit

FACTOR = 4
"""Cells of a level to the side of a cell of the next coarser one."""
ALL = (1 << FACTOR * FACTOR) - 1
"""The piece of a coarse cell that is passable all over."""
NO_PIECES = np.empty(0, np.uint16)
NO_LINKS = np.empty(0, np.uint8)
"""Of a level where passability decides."""
_FIRST_ROW = (1 << FACTOR) - 1
_FIRST_COL = ALL // _FIRST_ROW
_LAST_COL = _FIRST_COL << FACTOR - 1
_TO_LAST_ROW = FACTOR * (FACTOR - 1)
_ALL = np.uint16(ALL)
_EVERY_WAY = np.uint8(255)
_SIXTEENTH = np.float32(1 / 16)
_1 = np.uint64(1)
_2 = np.uint64(2)
_3 = np.uint64(3)


@helper
def _spread(piece, diagonally):
    """A set of a coarse cell's 16 cells, as bits row by row, and their neighbours within it."""
    beside = piece | (piece & ~_LAST_COL) << 1 | (piece & ~_FIRST_COL) >> 1
    up_and_down = beside if diagonally else piece
    return (beside | up_and_down << FACTOR | up_and_down >> FACTOR) & ALL


@helper
def _largest_of(passable, diagonally):
    """The largest connected set of the passable cells under a coarse cell, where passability alone
    decides.

    A diagonal step that may not cut corners joins no cells that straight steps do not.
    """
    best = 0
    best_size = 0
    while passable:
        before = 0
        piece = passable & -passable
        while piece != before:
            before = piece
            piece = _spread(piece, diagonally) & passable
        passable &= ~piece
        size = 0
        rest = piece
        while rest:
            rest &= rest - 1
            size += 1
        if size > best_size:
            best = piece
            best_size = size
    return best


@helper
def _largest_piece(weights, links, rows, cols, row, col, corner_cutting):
    """The largest connected piece of the passable cells under a coarse cell, as 16 bits, row by
    row.
    """
    stride = cols + 2
    passable = 0
    for b in range(FACTOR * FACTOR):
        i = row * FACTOR + b // FACTOR
        j = col * FACTOR + b % FACTOR
        if i < rows and j < cols and weights[(i + 1) * stride + j + 1] != np.inf:
            passable |= 1 << b
    if len(links) == 0:
        return passable if passable == ALL else _largest_of(passable, corner_cutting)
    best = 0
    best_size = 0
    while passable:
        piece = 0
        frontier = passable & -passable
        size = 0
        while frontier:
            bit = frontier & -frontier
            frontier ^= bit
            piece |= bit
            size += 1
            b = lowest_bit(bit)
            node = (row * FACTOR + b // FACTOR + 1) * stride + col * FACTOR + b % FACTOR + 1
            for k in range(8):
                i = b // FACTOR + ROW_STEP[k]
                j = b % FACTOR + COL_STEP[k]
                if 0 <= i < FACTOR and 0 <= j < FACTOR:
                    other = 1 << (i * FACTOR + j)
                    fresh = other & passable and not other & (piece | frontier)
                    if fresh and (links[node] >> k) & 1:
                        frontier |= other
        passable &= ~piece
        if size > best_size:
            best = piece
            best_size = size
    return best


@helper
def _pool_row(fine, first, stride, n, weights, at):
    """Means of `n` coarse cells that cover sixteen cells each, the first of which begin
    at `first`.
    """
    r0 = fine[first : first + FACTOR * n]
    r1 = fine[first + stride : first + stride + FACTOR * n]
    first += 2 * stride
    r2 = fine[first : first + FACTOR * n]
    r3 = fine[first + stride : first + stride + FACTOR * n]
    out = weights[at : at + n]
    for c in range(n):
        b = np.uint64(FACTOR * c)
        c0 = r0[b] + r1[b] + r2[b] + r3[b]
        c1 = r0[b + _1] + r1[b + _1] + r2[b + _1] + r3[b + _1]
        c2 = r0[b + _2] + r1[b + _2] + r2[b + _2] + r3[b + _2]
        c3 = r0[b + _3] + r1[b + _3] + r2[b + _3] + r3[b + _3]
        out[c] = ((c0 + c1) + (c2 + c3)) * _SIXTEENTH


@helper
def _common_below(fine, fine_cols, row, col):
    """The bits that the sixteen cells under a coarse cell, none of which may lie off the map, have
    in common.

    Of pieces: all where every piece is whole, and such cells are linked with one another. Of links:
    all where all leave each of them.
    """
    first = np.uint64((row * FACTOR + 1) * (fine_cols + 2) + col * FACTOR + 1)
    common = fine[first]
    for i in range(FACTOR):
        at = first + np.uint64(i * (fine_cols + 2))
        common &= fine[at] & fine[at + _1] & fine[at + _2] & fine[at + _3]
    return common


@helper
def _pool_cell(finer, row, col, corner_cutting, obstacle):
    """The piece that a coarse cell stands for, and its weight."""
    fine, _, fine_links, _, fine_rows, fine_cols = finer
    piece = _largest_piece(fine, fine_links, fine_rows, fine_cols, row, col, corner_cutting)
    if piece == 0:
        return piece, np.float32(np.inf)
    total = 0.0
    cells = 0
    for b in range(FACTOR * FACTOR):
        i = row * FACTOR + b // FACTOR
        j = col * FACTOR + b % FACTOR
        if i < fine_rows and j < fine_cols:
            cells += 1
            total += (
                np.float64(fine[(i + 1) * (fine_cols + 2) + j + 1])
                if (piece >> b) & 1
                else obstacle
            )
    return piece, np.float32(total / cells)


@helper
def pool(finer, corner_cutting, obstacle, area, coarse):
    """Weights and pieces of a rectangle of coarse cells; the least weight. As `pool_and_link`,
    without the links.

    Of the finer level's links those are read that lie within a coarse cell whose pieces are not all
    whole.
    """
    weights, pieces, _, stride, _, _ = coarse
    fine, fine_pieces, _, fine_stride, fine_rows, fine_cols = finer
    row0, row1, col0, col1 = area
    least = np.float32(np.inf)
    whole = max(
        min(col1, fine_cols // FACTOR), col0
    )  # from here on coarse cells stick out of the map
    for row in range(row0, row1):
        at = (row + 1) * stride + 1
        averaged = whole if row < fine_rows // FACTOR else col0
        if averaged > col0:
            first = (row * FACTOR + 1) * fine_stride + col0 * FACTOR + 1
            _pool_row(fine, first, fine_stride, averaged - col0, weights, at + col0)
        for col in range(col0, col1):
            whole_piece = col < averaged and weights[at + col] < np.inf
            if whole_piece and len(fine_pieces):
                whole_piece = _common_below(fine_pieces, fine_cols, row, col) == _ALL
            if whole_piece:
                pieces[at + col] = ALL
            else:
                piece, weight = _pool_cell(finer, row, col, corner_cutting, obstacle)
                pieces[at + col] = piece
                if piece != ALL:  # else the mean is there, rounded as that of any such cell
                    weights[at + col] = weight
            least = min(least, weights[at + col])
    return np.float64(least)


@helper
def _touching(weights, stride, row, col, here, there, up, left, corner_cutting):
    """Whether a step leads from a coarse cell's piece into that of its neighbour, where passability
    alone decides.
    """
    if left == 0:
        edge, other = (here, there >> _TO_LAST_ROW) if up < 0 else (here >> _TO_LAST_ROW, there)
        if corner_cutting:
            edge = _spread(edge & _FIRST_ROW, False)
        return edge & other & _FIRST_ROW != 0
    if up == 0:
        edge, other = (here, there >> FACTOR - 1) if left < 0 else (here >> FACTOR - 1, there)
        if corner_cutting:
            edge = _spread(edge & _FIRST_COL, False)
        return edge & other & _FIRST_COL != 0
    i = 0 if up < 0 else FACTOR - 1
    j = 0 if left < 0 else FACTOR - 1
    corner = i * FACTOR + j
    across = (FACTOR - 1 - i) * FACTOR + FACTOR - 1 - j
    if not (here >> corner) & (there >> across) & 1:
        return False
    node = (row * FACTOR + i + 1) * stride + col * FACTOR + j + 1
    return corner_cutting or (
        weights[node + up * stride] != np.inf and weights[node + left] != np.inf
    )


@helper
def _link_free_row(pieces, first, stride, n, links):
    """All links of those of `n` coarse cells in and beside which no impassable cell lies; none of
    the others.
    """
    top = first - stride
    bottom = first + stride
    t0 = pieces[top - 1 : top - 1 + n]
    t1 = pieces[top : top + n]
    t2 = pieces[top + 1 : top + 1 + n]
    m0 = pieces[first - 1 : first - 1 + n]
    m1 = pieces[first : first + n]
    m2 = pieces[first + 1 : first + 1 + n]
    b0 = pieces[bottom - 1 : bottom - 1 + n]
    b1 = pieces[bottom : bottom + n]
    b2 = pieces[bottom + 1 : bottom + 1 + n]
    out = links[first : first + n]
    for c in range(n):
        every = t0[c] & t1[c] & t2[c] & m0[c] & m1[c] & m2[c] & b0[c] & b1[c] & b2[c]
        out[c] = _EVERY_WAY if every == _ALL else np.uint8(0)


@helper
def _link_finest(fine, stride, corner_cutting, area, pieces, links, coarse_stride):
    """As `_link`, where passability alone decides."""
    row0, row1, col0, col1 = area
    for row in range(row0, row1):
        first = (row + 1) * coarse_stride + col0 + 1
        _link_free_row(pieces, first, coarse_stride, col1 - col0, links)
        for col in range(col0, col1):
            node = (row + 1) * coarse_stride + col + 1
            if links[node]:
                continue
            here = np.int64(pieces[node])
            found = 0
            for k in range(8):
                up = ROW_STEP[k]
                left = COL_STEP[k]
                there = np.int64(pieces[node + up * coarse_stride + left])
                if (
                    here
                    and there
                    and _touching(fine, stride, row, col, here, there, up, left, corner_cutting)
                ):
                    found |= 1 << k
            links[node] = found


@helper
def _link(fine_links, fine_cols, area, pieces, links, coarse_stride):
    """For a rectangle of coarse cells, the directions in which their pieces touch a neighbour's, as
    bits.
    """
    row0, row1, col0, col1 = area
    fine_stride = fine_cols + 2
    for row in range(row0, row1):
        _link_free_row(
            pieces, (row + 1) * coarse_stride + col0 + 1, coarse_stride, col1 - col0, links
        )
        for col in range(col0, col1):
            here = (row + 1) * coarse_stride + col + 1
            if links[here] and _common_below(fine_links, fine_cols, row, col) == _EVERY_WAY:
                continue  # no passage to a neighbour is closed
            piece = np.int64(pieces[here])
            found = 0
            for b in range(FACTOR * FACTOR):
                if not (piece >> b) & 1:
                    continue
                r = b // FACTOR
                c = b % FACTOR
                if 0 < r < FACTOR - 1 and 0 < c < FACTOR - 1:
                    continue
                node = (row * FACTOR + r + 1) * fine_stride + col * FACTOR + c + 1
                for k in range(8):
                    i = r + ROW_STEP[k]
                    j = c + COL_STEP[k]
                    up = (i >= 0) - 1 + (i >= FACTOR)
                    left = (j >= 0) - 1 + (j >= FACTOR)
                    if up == 0 and left == 0:
                        continue
                    towards = DIRECTION_OF[(up + 1) * 3 + left + 1]
                    if (found >> towards) & 1:
                        continue
                    neighbour = np.int64(pieces[here + up * coarse_stride + left])
                    if (neighbour >> ((i - up * FACTOR) * FACTOR + j - left * FACTOR)) & 1 and (
                        fine_links[node] >> k
                    ) & 1:
                        found |= 1 << towards
            links[here] = found


@kernel
def pool_and_link(finer, corner_cutting, obstacle, area, coarse):
    """Bring a rectangle of coarse cells up to date with the finer level, and the links of the cells
    around it.

    Parameters
    ----------
    finer, coarse : (weights, pieces, links, stride, rows, cols)
        The finer level, whose pieces and links are empty where passability decides, and the coarse
        one, written.
    corner_cutting : bool
        Whether a diagonal step of the finest level may pass an impassable cell.
    obstacle : float
        What an impassable cell counts for in a mean.
    area : (row0, row1, col0, col1)
        Of coarse cells.

    Returns
    -------
    float
        The least weight in the rectangle.
    """
    _, _, _, _, rows, cols = coarse
    least = pool(finer, corner_cutting, obstacle, area, coarse)
    row0, row1, col0, col1 = area
    wider = max(row0 - 1, 0), min(row1 + 1, rows), max(col0 - 1, 0), min(col1 + 1, cols)
    link(finer, corner_cutting, wider, coarse)
    return least


@helper
def link(finer, corner_cutting, area, coarse):
    """Links of a rectangle of coarse cells. As `pool_and_link`, whose pieces are up to date."""
    _, pieces, links, stride, _, _ = coarse
    if len(finer[2]) == 0:
        _link_finest(finer[0], finer[3], corner_cutting, area, pieces, links, stride)
    else:
        _link(finer[2], finer[5], area, pieces, links, stride)
