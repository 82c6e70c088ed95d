"""A map of heights whose costs and coarse levels are computed by tiles, where a search reads them.
See `map.tiles`.

The kernels that look are given `TilesRecord`. They call `open_tile` by its address: numba would
else compile it anew into each kernel that calls it.
"""

import numpy as np
from numpy import float32, inf, int64, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.by_address import blank, call_at, put_record, reader_of
from nnpp_edge.runtime.kernels.encoding import (
    add_costs,
    cells_of_part,
    cells_under,
    put_means,
)
from nnpp_edge.runtime.kernels.pooling import (
    NO_AREA,
    above,
    around,
    in_units,
    link,
    pool,
    with_cell,
)
from nnpp_edge.runtime.kernels.records import (
    LEVEL_COLS,
    LEVEL_FIRST,
    LEVEL_ROWS,
    LEVEL_STRIDE,
    Area,
    LevelRecord,
    Rectangle,
    TileSource,
    TilesRecord,
)
from nnpp_edge.runtime.kernels.traversability import MOST_COST, SCALE, fill_weights

COSTED = 1
SURROUNDED = 2
POOLED = 4
LINKED = 8
"""Of a tile: its weights are there; so are those around it; its coarse cells are there; all their
links are.
"""
BLOCK_UNTOUCHED = 0.0
BLOCK_UNKNOWN = 1.0
BLOCK_SEEN = 2.0
"""Of a block: its heights mean nothing; none is known; some may be."""
NO_SOURCE = blank(TileSource)
"""Of no map."""
_source_at = reader_of(TileSource)


# Which tiles are there


@kernel
def keep_source(source: TileSource, memory):
    """Write a source into memory, for `TilesRecord`."""
    put_record(memory, source)


@helper
def _tile_area(source, i, j):
    """The cells of a tile."""
    high = 1 << source.row_shift
    wide = 1 << source.col_shift
    row1 = min((i + 1) * high, source.rows)
    col1 = min((j + 1) * wide, source.cols)
    return Area(i * high, row1, j * wide, col1)


@inlined
def _tiles_under(source, area):
    """The tiles in which cells of a rectangle of the map lie."""
    return in_units(area, 1 << source.row_shift, 1 << source.col_shift)


@helper
def _cost_tile(tiles, source, i, j):
    """Compute the weights of a tile that are not there yet."""
    if not tiles.state[i, j] & COSTED:
        area = _tile_area(source, i, j)
        _fill(source, area)
        tiles.state[i, j] |= COSTED
        source.costed[0] += (area.row1 - area.row0) * (area.col1 - area.col0)


@kernel
def open_tile(tiles: TilesRecord, i, j):
    """Compute what is not yet there of a tile and of those around it, so that its cells may be
    left.
    """
    source = _source_at(tiles.source)
    state = tiles.state
    needed = POOLED if tiles.wanted == LINKED else COSTED
    for a in range(max(i - 1, 0), min(i + 2, state.shape[0])):
        for b in range(max(j - 1, 0), min(j + 2, state.shape[1])):
            if state[a, b] & needed:
                continue
            _cost_tile(tiles, source, a, b)
            if needed == POOLED:
                _pool_levels(source, _tile_area(source, a, b))
                state[a, b] |= POOLED
    if tiles.wanted == LINKED:
        _link_levels(source, _tile_area(source, i, j))
    state[i, j] |= tiles.wanted


@inlined
def open_there(tiles, i, j):
    """`open_tile`, for other kernels to call."""
    call_at(open_tile, tiles.open_tile, (tiles, i, j), None)


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
def compute_rows(tiles: TilesRecord, row0, row1):
    """Weights of whole rows of tiles, and the coarse cells above them with the links within.

    Rows `row0` to `row1` of the map are those of the tiles. Row of tiles by row of tiles: what is
    read again is near.
    """
    source = _source_at(tiles.source)
    down = source.row_shift
    for i in range(row0 >> down, ((row1 - 1) >> down) + 1):
        area = Area(i << down, min((i + 1) << down, row1), int64(0), source.cols)
        for j in range(tiles.state.shape[1]):
            if not tiles.state[i, j] & COSTED:
                _fill(source, area)
                break
        _pool_levels(source, area)


@kernel
def link_rows(tiles: TilesRecord, row0, row1):
    """All links of the coarse cells above whole rows of the map."""
    source = _source_at(tiles.source)
    area = Area(row0, row1, int64(0), source.cols)
    _link_levels(source, area)


# The levels


@helper
def _level(source, number):
    """A level by its number; 0 is the map, without pieces and links."""
    if number == 0:
        stride = source.cols + 2
        nothing = source.pieces[:0]
        links = source.links[:0]
        return LevelRecord(source.weights, nothing, links, stride, source.rows, source.cols)
    row = source.levels[number - 1]
    first = row[LEVEL_FIRST]
    stride = row[LEVEL_STRIDE]
    last = first + (row[LEVEL_ROWS] + 2) * stride
    weights = source.coarse[first:last]
    pieces = source.pieces[first:last]
    links = source.links[first:last]
    return LevelRecord(weights, pieces, links, stride, row[LEVEL_ROWS], row[LEVEL_COLS])


@helper
def _pool_levels(source, area):
    """Coarse cells above a rectangle of the map whose sides the coarsest cells divide, and the
    links within.
    """
    cutting = source.corner_cutting
    part = area
    for number in range(1, len(source.levels) + 1):
        finer = part
        fine = _level(source, number - 1)
        part = above(part)
        if number > 1:
            link(_level(source, number - 2), cutting, finer, fine)
        pool(fine, cutting, source.rule[SCALE], part, _level(source, number))


@helper
def _link_levels(source, area):
    """Links of the coarse cells above a rectangle of the map, all pieces in and around it being
    there.
    """
    part = area
    for number in range(1, len(source.levels) + 1):
        part = above(part)
        link(_level(source, number - 1), source.corner_cutting, part, _level(source, number))


@helper
def _pool_anew(tiles, source, changed):
    """Coarse cells above a rectangle whose weights changed, in the tiles that have any, and their
    links.
    """
    part = changed
    down = source.row_shift
    right = source.col_shift
    for number in range(1, len(source.levels) + 1):
        fine = _level(source, number - 1)
        coarse = _level(source, number)
        down -= 2
        right -= 2
        part = above(part)
        for linking in range(2):
            if linking:  # what is linked changes around what is pooled, too
                part = around(part, coarse, 1)
            under = in_units(part, 1 << down, 1 << right)
            for i in range(under.row0, under.row1):
                for j in range(under.col0, under.col1):
                    if not tiles.state[i, j] & POOLED:
                        continue
                    tile = Area(i << down, (i + 1) << down, j << right, (j + 1) << right)
                    inside = _shared(part, tile)
                    if linking:
                        link(fine, source.corner_cutting, inside, coarse)
                    else:
                        pool(fine, source.corner_cutting, source.rule[SCALE], inside, coarse)


@inlined
def _shared(one, other):
    """What two rectangles share."""
    row0 = max(one.row0, other.row0)
    row1 = min(one.row1, other.row1)
    return Area(row0, row1, max(one.col0, other.col0), min(one.col1, other.col1))


# Weights


@helper
def _fill(source, area):
    """Weights of a rectangle of the map, into their places."""
    stride = source.cols + 2
    _weigh(source, area, source.weights, stride + 1, stride)


@helper
def _weigh(source, area, out, first, stride):
    """Weights of a rectangle of the map, by heights, costs told and prices; what is written as by
    `fill_weights`.
    """
    blocks = source.block_side > 0
    if not blocks or _any_seen(source, area):
        fill_weights(
            source.heights, source.rows, source.cols, source.rule, area, out, first, stride
        )
    if blocks:
        _weigh_unseen(source, area, out, first, stride)
    if len(source.added) == 0 and not source.tells[0]:
        return
    scale = source.rule[SCALE]
    most = float32(MOST_COST * scale)
    for row in range(area.row0, area.row1):
        for col in range(area.col0, area.col1):
            cell = row * source.cols + col
            at = first + row * stride + col
            if len(source.added) and out[at] < inf:
                weight = out[at] + float32(source.added[cell] * scale)
                out[at] = min(weight, most) if weight < inf else float32(inf)  # or 0 · inf
            cost = source.told[cell]
            if cost > 0.0:
                weight = float32(cost * scale) if cost < 1.0 else float32(inf)
                out[at] = max(out[at], weight)


@helper
def _weigh_unseen(source, area, out, first, stride):
    """Weights of cells that are not known, by the prices of their blocks."""
    scale = source.rule[SCALE]
    side = source.block_side
    for row in range(area.row0, area.row1):
        col = area.col0
        while col < area.col1:
            block = row // side * source.block_cols + col // side
            end = min((col // side + 1) * side, area.col1)
            price = float32(source.block_prices[block] * scale)
            seen = source.block_states[block] == BLOCK_SEEN
            for c in range(col, end):
                at = first + row * stride + c
                if not (seen and abs(source.heights[row * source.cols + c]) < inf):
                    out[at] = price
                elif out[at] == inf and not _all_known(source, row, c):
                    out[at] = max(price, float32(scale))
            col = end


@helper
def _all_known(source, row, col):
    """Whether a cell's neighbours are known: else a slope too steep may be that of a part
    of them.
    """
    for i in range(max(row - 1, 0), min(row + 2, source.rows)):
        for j in range(max(col - 1, 0), min(col + 2, source.cols)):
            if not abs(source.heights[i * source.cols + j]) < inf:
                return False
    return True


@helper
def _any_seen(source, area):
    """Whether anything may be known of the heights in a rectangle of the map."""
    blocks = in_units(area, source.block_side, source.block_side)
    for i in range(blocks.row0, blocks.row1):
        for j in range(blocks.col0, blocks.col1):
            if source.block_states[i * source.block_cols + j] == BLOCK_SEEN:
                return True
    return False


# Patches


@helper
def _put_new(layer, cols, patch, seen, row, col):
    """Write the values of a patch that are seen into a layer; the rectangle of those that are other
    ones than before, empty where nothing is new.

    Values that are not finite are all alike, as far as neither is finite.
    """
    found = NO_AREA
    for i in range(patch.shape[0]):
        at = (row + i) * cols + col
        for j in range(patch.shape[1]):
            new = patch[i, j]
            old = layer[at + j]
            alike = new == old or not (abs(new) < inf or abs(old) < inf)
            if alike or (seen.size and not seen[i, j]):
                continue
            layer[at + j] = new
            found = with_cell(found, row + i, col + j)
    return found


@helper
def _weigh_anew(source, area, nodes, old_weights, noted):
    """Weights of a rectangle within one computed tile: how many have changed, whether one became
    cheaper, the rectangle that holds these, empty without any, and how many nodes are noted.
    """
    wide = area.col1 - area.col0
    weights = np.empty((area.row1 - area.row0) * wide, float32)
    _weigh(source, area, weights, -area.row0 * wide - area.col0, wide)
    changed = 0
    cheaper = False
    found = NO_AREA
    for row in range(area.row0, area.row1):
        first = (row + 1) * (source.cols + 2) + area.col0 + 1
        line = weights[(row - area.row0) * wide : (row - area.row0 + 1) * wide]
        for n in range(wide):
            before = source.weights[first + n]
            if line[n] != before:
                if len(nodes):
                    nodes[noted] = first + n
                    old_weights[noted] = before
                    noted += 1
                changed += 1
                cheaper |= line[n] < before
                found = with_cell(found, row, area.col0 + n)
                source.weights[first + n] = line[n]
    return changed, cheaper, found, noted


@inlined
def _both(one, other):
    """The rectangle that holds two, neither of which may be empty unless its bounds are crossed."""
    row0 = min(one.row0, other.row0)
    row1 = max(one.row1, other.row1)
    return Area(row0, row1, min(one.col0, other.col0), max(one.col1, other.col1))


@kernel
def write_layer(tiles: TilesRecord, layer, rim, patch, seen, row, col, nodes, old_weights):
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
    nodes, old_weights : (N,) int32, float32
        Written: the changed nodes and what they weighed, which is computed where it is not yet.
        With room for all cells of the patch and its rim, or empty: then nothing is noted.

    Returns
    -------
    tuple
        The number of cells whose weights are other than before, where what is not computed yet
        counts as other; whether one became cheaper; the `Area` that holds them; how many nodes were
        noted; the `Area` that holds all new values, all 0 without any.
    """
    source = _source_at(tiles.source)
    changed = NO_AREA
    cells = 0
    cheaper = False
    noted = 0
    if len(nodes):
        written = Area(row, row + patch.shape[0], col, col + patch.shape[1])
        under = _tiles_under(source, around(written, source, rim))
        for i in range(under.row0, under.row1):
            for j in range(under.col0, under.col1):
                _cost_tile(tiles, source, i, j)
    new = _put_new(layer, source.cols, patch, seen, row, col)
    nothing = (0, 0, 0, 0)
    if new.row0 >= new.row1:
        return cells, cheaper, nothing, noted, nothing
    near = around(new, source, rim)
    under = _tiles_under(source, near)
    for i in range(under.row0, under.row1):
        for j in range(under.col0, under.col1):
            inside = _shared(near, _tile_area(source, i, j))
            if tiles.state[i, j] & COSTED:
                found = _weigh_anew(source, inside, nodes, old_weights, noted)
                count, falls, inside, noted = found
                cells += count
                cheaper |= falls
                if count == 0:
                    continue
            else:
                cells += (inside.row1 - inside.row0) * (inside.col1 - inside.col0)
            changed = _both(changed, inside)
    if cells and len(source.levels):
        _pool_anew(tiles, source, changed)
    part = (changed.row0, changed.row1, changed.col0, changed.col1)
    return cells, cheaper, part, noted, (new.row0, new.row1, new.col0, new.col1)


# What a network is shown


@kernel
def sample_planes(tiles: TilesRecord, window: Rectangle, parts, inner, planes):
    """Mean cost and share of impassable cells of parts of a window of the map, from two rows of
    each network cell.

    Nothing of it is kept. See `network.encoding.map_planes`, which averages all cells.

    Parameters
    ----------
    window
        `Rectangle`.
    parts : (N, 4) int64
        `Rectangle`s within the window.
    inner : (rows, cols)
        Of the network's cells that the window lies under.
    planes : (2, S, S) float32
        Written.
    """
    source = _source_at(tiles.source)
    shape = (window.rows, window.cols)
    inner_rows, inner_cols = inner
    scale = source.rule[SCALE]
    per_weight = float32(1.0 / scale) if scale > 0.0 else float32(0.0)
    line = np.empty(window.cols, float32)
    sums = np.empty(window.cols, float32)
    walls = np.empty(window.cols, float32)
    for n in range(len(parts)):
        part = cells_of_part(parts[n], shape, inner)
        if part.row0 >= part.row1 or part.col0 >= part.col1:
            continue
        begin, _ = cells_under(part.col0, inner_cols, window.cols)
        _, end = cells_under(part.col1 - 1, inner_cols, window.cols)
        for i in range(part.row0, part.row1):
            top, bottom = cells_under(i, inner_rows, window.rows)
            apart = max((bottom - top) // 2, 1)
            lines = 0
            sums[begin:end] = 0.0
            walls[begin:end] = 0.0
            for row in range(window.row + top + (apart - 1) // 2, window.row + bottom, apart):
                lines += 1
                area = Area(row, row + 1, window.col + begin, window.col + end)
                _weigh(source, area, line, -row * window.cols - window.col, window.cols)
                costs = line[begin:end]
                add_costs(costs, per_weight, float32(0.0), sums[begin:end], walls[begin:end])
            put_means(planes, i, part, inner_cols, lines, sums, walls)
