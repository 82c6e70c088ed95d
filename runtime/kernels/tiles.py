"""A map of heights whose costs and coarse levels are computed by tiles, where a search reads them.
See `map.tiles`.

The kernels that look are given `tiles`, a tuple (state, wanted, row_shift, col_shift, source,
address): what has been done to each tile, as bits; the bit without which a cell of it may not be
left; by how many bits a row and a column of the level at hand are shifted to give the tile's; and
where `open_tile` lies in memory. It is called by its address: numba would else compile it anew into
each kernel that calls it. `source` is a tuple

    heights    (rows · cols,) float32, metres; not finite where unknown
    rule       (RULE_SLOTS,) float64, see `fill_weights`
    weights    (nodes,) float32 of the map
    levels     (1 + levels, 4) int64: row shift, column shift, corner cutting and number of
               coarse levels; then rows, columns, stride and first node of each coarse level
    coarse     (…,) float32, weights of all coarse levels, one after another
    pieces     (…,) uint16, likewise
    links      (…,) uint8, likewise
    counts     (COUNT_SLOTS,) int64, see `CELLS_COSTED`
    shape      (2,) int64, rows and columns of the map
    told       (rows · cols,) float32, costs that were told: a cell weighs by the greater of both
    unseen     (2 · blocks,) float32, on a map of which blocks of cells are known by their means:
               the price of each block, T a cell that is not known, then what is known of
               it, see `UNTOUCHED`
"""

import numpy as np
from numba.extending import overload
from numpy import int64, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.by_address import call_at
from nnpp_edge.runtime.kernels.encoding import cells_under
from nnpp_edge.runtime.kernels.pooling import FACTOR, link, pool
from nnpp_edge.runtime.kernels.traversability import SCALE, fill_weights

COSTED = 1
SURROUNDED = 2
POOLED = 4
LINKED = 8
"""Of a tile: its weights are there; so are those around it; its coarse cells are there; all their
links are.
"""
CELLS_COSTED = 0
ANY_TOLD = 1
BLOCK_SIDE = 2
BLOCK_COLS = 3
COUNT_SLOTS = 4
"""Of `counts`: cells of computed tiles; whether any cost was told; cells to a block's side, 0
without blocks, and blocks in a row."""
UNTOUCHED = 0.0
UNKNOWN = 1.0
SEEN = 2.0
"""Of a block: its heights mean nothing; none is known; some may be."""
_ROWS = 0
_COLS = 1
_STRIDE = 2
_FIRST = 3
CELLS = 0
CHEAPER = 1
TOP = 2
LEFT = 3
BOTTOM = 4
END = 5
NOTED = 6
NEW = 7
FOUND_SLOTS = 11
"""Of what `write_layer` has found."""


@helper
def _level(source, number):
    """A level as the kernels of `pooling` take it; 0 is the map, without pieces and links."""
    _, _, weights, levels, coarse, pieces, links, _, shape, _, _ = source
    if number == 0:
        return weights, pieces[:0], links[:0], shape[1] + 2, shape[0], shape[1]
    first = levels[number, _FIRST]
    rows = levels[number, _ROWS]
    stride = levels[number, _STRIDE]
    last = first + (rows + 2) * stride
    return (
        coarse[first:last],
        pieces[first:last],
        links[first:last],
        stride,
        rows,
        levels[number, _COLS],
    )


@helper
def _pool_levels(source, area):
    """Coarse cells above a rectangle of the map whose sides the coarsest cells divide, and the
    links within.
    """
    rule = source[1]
    levels = source[3]
    corner_cutting = levels[0, 2] != 0
    part = area
    for number in range(1, levels[0, 3] + 1):
        finer = part
        fine = _level(source, number - 1)
        part = part[0] // FACTOR, -(-part[1] // FACTOR), part[2] // FACTOR, -(-part[3] // FACTOR)
        if number > 1:
            link(_level(source, number - 2), corner_cutting, finer, fine)
        pool(fine, corner_cutting, rule[SCALE], part, _level(source, number))


@helper
def _link_levels(source, area):
    """Links of the coarse cells above a rectangle of the map, all pieces in and around it being
    there.
    """
    levels = source[3]
    part = area
    for number in range(1, levels[0, 3] + 1):
        part = part[0] // FACTOR, -(-part[1] // FACTOR), part[2] // FACTOR, -(-part[3] // FACTOR)
        link(_level(source, number - 1), levels[0, 2] != 0, part, _level(source, number))


@helper
def _weigh(source, area, out, first, stride):
    """Weights of a rectangle of the map, by heights, costs told and prices; what is written as by
    `fill_weights`.
    """
    heights, rule, _, _, _, _, _, counts, shape, told, unseen = source
    side = counts[BLOCK_SIDE]
    blocks = counts[BLOCK_COLS]
    if side == 0 or _any_seen(unseen, side, blocks, area):
        fill_weights(heights, shape[0], shape[1], rule, area, out, first, stride)
    row0, row1, col0, col1 = area
    if side:
        for row in range(row0, row1):
            col = col0
            while col < col1:
                block = row // side * blocks + col // side
                end = min((col // side + 1) * side, col1)
                price = np.float32(unseen[block] * rule[SCALE])
                known = unseen[len(unseen) // 2 + block] == SEEN
                for c in range(col, end):
                    at = first + row * stride + c
                    if not (known and abs(heights[row * shape[1] + c]) < np.inf):
                        out[at] = price
                    elif out[at] == np.inf and not _all_known(heights, shape, row, c):
                        out[at] = max(price, np.float32(rule[SCALE]))
                col = end
    if counts[ANY_TOLD] == 0:
        return
    for row in range(row0, row1):
        for col in range(col0, col1):
            cost = told[row * shape[1] + col]
            if cost > 0.0:
                at = first + row * stride + col
                weight = np.float32(cost * rule[SCALE]) if cost < 1.0 else np.float32(np.inf)
                out[at] = max(out[at], weight)


@helper
def _all_known(heights, shape, row, col):
    """Whether a cell's neighbours are known: else a slope too steep may be that of a part
    of them.
    """
    for i in range(max(row - 1, 0), min(row + 2, shape[0])):
        for j in range(max(col - 1, 0), min(col + 2, shape[1])):
            if not abs(heights[i * shape[1] + j]) < np.inf:
                return False
    return True


@helper
def _any_seen(unseen, side, blocks, area):
    """Whether anything may be known of the heights in a rectangle of the map."""
    for i in range(area[0] // side, (area[1] - 1) // side + 1):
        for j in range(area[2] // side, (area[3] - 1) // side + 1):
            if unseen[len(unseen) // 2 + i * blocks + j] == SEEN:
                return True
    return False


@helper
def _see_blocks(source, row, col, patch, seen):
    """Have the blocks under a patch of heights take them; those around are unknown where nothing
    was seen.
    """
    heights, _, _, _, _, _, _, counts, shape, _, unseen = source
    side = counts[BLOCK_SIDE]
    blocks = counts[BLOCK_COLS]
    high = shape[0] // side
    for i in range(row // side, (row + patch.shape[0] - 1) // side + 1):
        for j in range(col // side, (col + patch.shape[1] - 1) // side + 1):
            at = len(unseen) // 2 + i * blocks + j
            if unseen[at] == SEEN:
                continue
            new = False
            for r in range(max(i * side, row), min((i + 1) * side, row + patch.shape[0])):
                for c in range(max(j * side, col), min((j + 1) * side, col + patch.shape[1])):
                    new |= abs(patch[r - row, c - col]) < np.inf and (
                        seen.size == 0 or seen[r - row, c - col]
                    )
            if not new:
                continue
            for a in range(max(i - 1, 0), min(i + 2, high)):
                for b in range(max(j - 1, 0), min(j + 2, blocks)):
                    beside = len(unseen) // 2 + a * blocks + b
                    if unseen[beside] == UNTOUCHED:
                        for r in range(a * side, (a + 1) * side):
                            heights[r * shape[1] + b * side : r * shape[1] + (b + 1) * side] = (
                                np.nan
                            )
                        unseen[beside] = UNKNOWN
            unseen[at] = SEEN


@helper
def _fill(source, area):
    """Weights of a rectangle of the map, into their places."""
    stride = source[8][1] + 2
    _weigh(source, area, source[2], stride + 1, stride)


@helper
def _tile_area(source, i, j):
    """First row, one past the last, and so for the columns, of a tile."""
    _, _, _, levels, _, _, _, _, shape, _, _ = source
    high = 1 << levels[0, 0]
    wide = 1 << levels[0, 1]
    return i * high, min((i + 1) * high, shape[0]), j * wide, min((j + 1) * wide, shape[1])


@helper
def _cost_tile(tiles, i, j):
    """Compute the weights of a tile that are not there yet."""
    state = tiles[0]
    source = tiles[4]
    if not state[i, j] & COSTED:
        area = _tile_area(source, i, j)
        _fill(source, area)
        state[i, j] |= COSTED
        source[7][CELLS_COSTED] += (area[1] - area[0]) * (area[3] - area[2])


@kernel
def open_tile(tiles, i, j):
    """Compute what is not yet there of a tile and of those around it, so that its cells may be
    left.
    """
    state, wanted, _, _, source, _ = tiles
    needed = POOLED if wanted == LINKED else COSTED
    for a in range(max(i - 1, 0), min(i + 2, state.shape[0])):
        for b in range(max(j - 1, 0), min(j + 2, state.shape[1])):
            if state[a, b] & needed:
                continue
            _cost_tile(tiles, a, b)
            if needed == POOLED:
                _pool_levels(source, _tile_area(source, a, b))
                state[a, b] |= POOLED
    if wanted == LINKED:
        _link_levels(source, _tile_area(source, i, j))
    state[i, j] |= wanted


@kernel
def open_along(tiles, path):
    """As `open_tile`, of all tiles in which cells of a path (N, 2) inside the map lie."""
    state, wanted, down, right, _, _ = tiles
    for n in range(len(path)):
        i = path[n, 0] >> down
        j = path[n, 1] >> right
        if not state[i, j] & wanted:
            open_tile(tiles, i, j)


def open_there(tiles, i, j):
    """`open_tile`, for other kernels to call."""
    open_tile(tiles, i, j)


@overload(open_there)
def _compiled_open_there(tiles, i, j):
    return lambda tiles, i, j: call_at(tiles[5], (tiles, i, j))


@inlined
def open_at(tiles, row, col):
    """See to it that a cell may be left; whether anything had to be computed for that."""
    i = uint64(row >> tiles.row_shift)
    j = uint64(col >> tiles.col_shift)
    if tiles.state[i, j] & tiles.wanted:
        return False
    open_there(tiles, int64(i), int64(j))
    return True


@kernel
def compute_rows(tiles, row0, row1):
    """Weights of whole rows of tiles, and the coarse cells above them with the links within.

    Rows `row0` to `row1` of the map are those of the tiles. Row of tiles by row of tiles: what is
    read again is near.
    """
    state, _, _, _, source, _ = tiles
    down = source[3][0, 0]
    cols = source[8][1]
    for i in range(row0 >> down, ((row1 - 1) >> down) + 1):
        area = i << down, min((i + 1) << down, row1), np.int64(0), cols
        for j in range(state.shape[1]):
            if not state[i, j] & COSTED:
                _fill(source, area)
                break
        _pool_levels(source, area)


@kernel
def link_rows(tiles, row0, row1):
    """All links of the coarse cells above whole rows of the map."""
    source = tiles[4]
    _link_levels(source, (row0, row1, np.int64(0), source[8][1]))


@helper
def _weigh_anew(tiles, area, found, nodes, old_weights):
    """Weights of a rectangle within one computed tile; what changed is added to all three, see
    `write_layer`.
    """
    source = tiles[4]
    _, _, weights, _, _, _, _, _, shape, _, _ = source
    row0, row1, col0, col1 = area
    stride = shape[1] + 2
    wide = col1 - col0
    old = np.empty((row1 - row0) * wide, np.float32)
    for row in range(row0, row1):
        at = (row + 1) * stride + col0 + 1
        kept = (row - row0) * wide
        old[kept : kept + wide] = weights[at : at + wide]
    _fill(source, area)
    changed = 0
    cheaper = False
    noted = found[NOTED]
    top = found[TOP]
    left = found[LEFT]
    bottom = found[BOTTOM]
    end = found[END]
    for row in range(row0, row1):
        at = (row + 1) * stride + col0 + 1
        kept = (row - row0) * wide
        before_row = changed
        for c in range(wide):
            before = old[kept + c]
            now = weights[at + c]
            if now != before:
                if len(nodes):
                    nodes[noted] = at + c
                    old_weights[noted] = before
                    noted += 1
                changed += 1
                cheaper |= now < before
                left = min(left, col0 + c)
                end = max(end, col0 + c + 1)
        if changed != before_row:
            top = min(top, row)
            bottom = max(bottom, row + 1)
    found[CELLS] += changed
    found[CHEAPER] |= cheaper
    found[TOP] = top
    found[LEFT] = left
    found[BOTTOM] = bottom
    found[END] = end
    found[NOTED] = noted


@helper
def _put_new(layer, cols, patch, seen, row, col):
    """Write the values of a patch that are seen into a layer; the rectangle of those that are other
    ones than before.

    It is (first row, one past the last, first column, one past the last), and empty where nothing
    is new. Values that are not finite are all alike, as far as neither is finite.
    """
    top = patch.shape[0]
    bottom = 0
    left = patch.shape[1]
    end = 0
    for i in range(patch.shape[0]):
        at = (row + i) * cols + col
        new_row = False
        for c in range(patch.shape[1]):
            new = patch[i, c]
            old = layer[at + c]
            if (
                new == old
                or (seen.size and not seen[i, c])
                or not (abs(new) < np.inf or abs(old) < np.inf)
            ):
                continue
            layer[at + c] = new
            new_row = True
            left = min(left, c)
            end = max(end, c + 1)
        if new_row:
            top = min(top, i)
            bottom = i + 1
    return row + top, row + bottom, col + left, col + end


@kernel
def write_layer(tiles, layer, rim, patch, seen, row, col, found, nodes, old_weights):
    """Put values into a layer of the map, and bring up to date whatever of it has been computed.

    Parameters
    ----------
    layer : (rows · cols,) float32
        Its heights, or the costs told.
    rim : int
        Cells around a value that it matters to: 1 for heights, 0 for costs.
    patch : (h, w) float32
        Its first cell goes to `row`, `col`; must lie inside the map.
    seen : (h, w) bool
        Cells that are written; (0, 0) for all.
    found : (FOUND_SLOTS,) int64
        Written: the number of cells whose weights are other than before; whether one became
        cheaper; the rectangle that holds them; how many nodes were noted; the rectangle that holds
        all new values. Rectangles are first row and column, and one past the last. What is not
        computed yet counts as other.
    nodes, old_weights : (N,) int32, float32
        Written: the changed nodes and what they weighed, which is computed where it is not yet.
        With room for all cells of the patch and its rim, or empty: then nothing is noted.
    """
    state, _, _, _, source, _ = tiles
    levels = source[3]
    shape = source[8]
    rows = shape[0]
    cols = shape[1]
    down = levels[0, 0]
    right = levels[0, 1]
    if len(nodes):
        for i in range(
            max(row - rim, 0) >> down, ((min(row + patch.shape[0] + rim, rows) - 1) >> down) + 1
        ):
            for j in range(
                max(col - rim, 0) >> right,
                ((min(col + patch.shape[1] + rim, cols) - 1) >> right) + 1,
            ):
                _cost_tile(tiles, i, j)
    found[:] = 0
    if rim and source[7][BLOCK_SIDE]:
        _see_blocks(source, row, col, patch, seen)
    first, last, begin, past = _put_new(layer, cols, patch, seen, row, col)
    if first >= last:
        return
    found[NEW] = first
    found[NEW + 1] = begin
    found[NEW + 2] = last
    found[NEW + 3] = past
    found[TOP] = rows
    found[LEFT] = cols
    row0 = max(first - rim, 0)
    row1 = min(last + rim, rows)
    col0 = max(begin - rim, 0)
    col1 = min(past + rim, cols)
    for i in range(row0 >> down, ((row1 - 1) >> down) + 1):
        for j in range(col0 >> right, ((col1 - 1) >> right) + 1):
            tile_row0, tile_row1, tile_col0, tile_col1 = _tile_area(source, i, j)
            top = max(row0, tile_row0)
            bottom = min(row1, tile_row1)
            left = max(col0, tile_col0)
            end = min(col1, tile_col1)
            if state[i, j] & COSTED:
                _weigh_anew(tiles, (top, bottom, left, end), found, nodes, old_weights)
            else:
                found[CELLS] += (bottom - top) * (end - left)
                found[TOP], found[BOTTOM] = min(found[TOP], top), max(found[BOTTOM], bottom)
                found[LEFT], found[END] = min(found[LEFT], left), max(found[END], end)
    if found[CELLS] and levels[0, 3]:
        _pool_anew(tiles, found)


@helper
def _pool_anew(tiles, found):
    """Coarse cells above a rectangle whose weights changed, in the tiles that have any, and their
    links.
    """
    state, _, _, _, source, _ = tiles
    _, rule, _, levels, _, _, _, _, _, _, _ = source
    row0 = found[TOP]
    col0 = found[LEFT]
    row1 = found[BOTTOM]
    col1 = found[END]
    corner_cutting = levels[0, 2] != 0
    obstacle = rule[SCALE]
    down = levels[0, 0]
    right = levels[0, 1]
    for number in range(1, levels[0, 3] + 1):
        fine = _level(source, number - 1)
        coarse = _level(source, number)
        down -= 2
        right -= 2
        row0 = row0 // FACTOR
        row1 = -(-row1 // FACTOR)
        col0 = col0 // FACTOR
        col1 = -(-col1 // FACTOR)
        for linking in range(2):
            if linking:  # what is linked changes around what is pooled, too
                row0 = max(row0 - 1, 0)
                row1 = min(row1 + 1, coarse[4])
                col0 = max(col0 - 1, 0)
                col1 = min(col1 + 1, coarse[5])
            for i in range(row0 >> down, ((row1 - 1) >> down) + 1):
                for j in range(col0 >> right, ((col1 - 1) >> right) + 1):
                    if not state[i, j] & POOLED:
                        continue
                    top = max(row0, i << down)
                    bottom = min(row1, (i + 1) << down)
                    part = top, bottom, max(col0, j << right), min(col1, (j + 1) << right)
                    if linking:
                        link(fine, corner_cutting, part, coarse)
                    else:
                        pool(fine, corner_cutting, obstacle, part, coarse)


@kernel
def sample_planes(tiles, window, parts, inner, planes):
    """Mean cost and share of impassable cells of parts of a window of the map, from two rows of
    each network cell.

    Nothing of it is kept. See `network.encoding.map_planes`, which averages all cells.

    Parameters
    ----------
    window : (row, col, rows, cols)
    parts : (N, 4) int64
        Row, column, rows and columns of rectangles within the window.
    inner : (rows, cols)
        Of the network's cells that the window lies under.
    planes : (2, S, S) float32
        Written.
    """
    source = tiles[4]
    rule = source[1]
    per_weight = np.float32(1.0 / rule[SCALE]) if rule[SCALE] > 0.0 else np.float32(0.0)
    row0, col0, rows, cols = window
    inner_rows, inner_cols = inner
    line = np.empty(cols, np.float32)
    sums = np.empty(cols, np.float32)
    walls = np.empty(cols, np.float32)
    for p in range(len(parts)):
        first_row = parts[p, 0] * inner_rows // rows
        last_row = -(-(parts[p, 0] + parts[p, 2]) * inner_rows // rows)
        first_col = parts[p, 1] * inner_cols // cols
        last_col = -(-(parts[p, 1] + parts[p, 3]) * inner_cols // cols)
        last_row = min(last_row, inner_rows)
        last_col = min(last_col, inner_cols)
        if first_row >= last_row or first_col >= last_col:
            continue
        begin = cells_under(first_col, inner_cols, cols)[0]
        end = cells_under(last_col - 1, inner_cols, cols)[1]
        for n in range(first_row, last_row):
            top, bottom = cells_under(n, inner_rows, rows)
            apart = max((bottom - top) // 2, 1)
            lines = 0
            sums[begin:end] = 0.0
            walls[begin:end] = 0.0
            for row in range(top + (apart - 1) // 2, bottom, apart):
                lines += 1
                area = row0 + row, row0 + row + 1, col0 + begin, col0 + end
                _weigh(source, area, line, -(row0 + row) * cols - col0, cols)
                _add(line[begin:end], per_weight, sums[begin:end], walls[begin:end])
            for m in range(first_col, last_col):
                left, right = cells_under(m, inner_cols, cols)
                total = np.float32(0.0)
                blocked = np.float32(0.0)
                for c in range(left, right):
                    total += sums[c]
                    blocked += walls[c]
                over_cells = np.float32(1.0 / (lines * (right - left)))
                planes[0, n, m] = total * over_cells
                planes[1, n, m] = blocked * over_cells


@helper
def _add(line, per_weight, sums, walls):
    """Add weights as costs to sums, impassable cells as 1, and count those in `walls`. All (n,)
    float32.
    """
    for c in range(len(line)):
        wall = line[c] == np.inf
        sums[c] += np.float32(1.0) if wall else line[c] * per_weight
        walls[c] += np.float32(1.0) if wall else np.float32(0.0)
