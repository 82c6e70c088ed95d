"""Searches of blocks whose links have prices, against a plain Dijkstra."""

import heapq

import numpy as np
import pytest

from nnpp_edge.runtime.kernels.nodes import STAMP_SHIFT
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.region.links import CLOSED, Links, LinkSearch
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.vehicle import HEADINGS

LENGTHS = np.array((4.0, 4.0 * 2**0.5, 4.0, 4.0 * 2**0.5), np.float32)[:, None, None]


def neighbours(prices, row, col):
    """Blocks beside one, and the prices of the links to them."""
    rows, cols = prices.shape[1:]
    for heading, (down, right) in enumerate(HEADINGS):
        for sign in (1, -1):
            i, j = row + sign * down, col + sign * right
            if 0 <= i < rows and 0 <= j < cols:
                at = (row, col) if sign == 1 else (i, j)
                yield (i, j), float(prices[heading][at])


def costs_from(prices, start):
    """Cost of the cheapest way from a block to every other."""
    found, waiting = {}, [(0.0, start)]
    while waiting:
        cost, block = heapq.heappop(waiting)
        if block in found:
            continue
        found[block] = cost
        for other, price in neighbours(prices, *block):
            heapq.heappush(waiting, (cost + price, other))
    field = np.empty(prices.shape[1:])
    for block, cost in found.items():
        field[block] = cost
    return field


def random_links(rng):
    """(4, R, C) prices of links, R and C, and two cells of their map."""
    rows, cols = rng.integers(3, 14, 2)
    prices = (LENGTHS * (1.0 + 4.0 * rng.random((4, rows, cols)) ** 3)).astype(np.float32)
    return prices, (rows, cols), [(int(rng.integers(4 * rows)), int(rng.integers(4 * cols))) for _ in range(2)]


@pytest.mark.parametrize("seed", range(8))
def test_the_region_holds_just_the_blocks_on_ways_that_cost_nearly_the_least(seed):
    rng = np.random.default_rng(seed)
    prices, (rows, cols), (start, goal) = random_links(rng)
    band = float(rng.choice([0.0, 0.05, 0.3]))
    region, _ = LinkSearch((4 * rows, 4 * cols)).around(
        Links.of(prices), (start, goal), band, 0, float(rng.choice([0.7, 1.0]))
    )
    check_region(region, prices, start, goal, band)


def check_region(region, prices, start, goal, band):
    """Against plain fields of costs from both ends."""
    rows, cols = prices.shape[1:]
    inside = region.blocks()[::2, ::2]
    ends = (start[0] // 4, start[1] // 4), (goal[0] // 4, goal[1] // 4)
    through = costs_from(prices, ends[0]) + costs_from(prices, ends[1])
    limit = (1.0 + band) * through[ends[0]]
    near_ends = np.zeros_like(inside)
    for row, col in ends:
        near_ends[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2] = True
    assert (inside | (through > limit * (1.0 - 1e-5))).all()
    assert not (inside & ~near_ends & (through > limit * (1.0 + 1e-4))).any()


@pytest.mark.parametrize("seed", range(12))
def test_searched_again_once_links_are_dearer_the_region_is_that_of_the_new_prices(seed):
    rng = np.random.default_rng(seed)
    prices, (rows, cols), (start, goal) = random_links(rng)
    search, query, band = LinkSearch((4 * rows, 4 * cols)), (start, goal), float(rng.choice([0.01, 0.2]))
    search.around(Links.of(prices), query, band, 0)
    for _ in range(3):
        prices = prices + np.float32(30.0) * (rng.random(prices.shape) < 0.3)
        check_region(search.around_again(Links.of(prices), query, band, 0)[0], prices, start, goal, band)


def test_links_are_closed_where_a_search_of_the_region_got_no_farther():
    prices = np.broadcast_to(LENGTHS, (4, 3, 4)).astype(np.float32)
    bitmap = np.zeros((6, 8), np.int32)
    bitmap[2:4] = 1  # the middle row of blocks
    quarters = tuple(np.arange(n, dtype=np.int32) // 2 for n in (12, 16))
    searched = Workspace(14 * 18)
    searched.next_stamp()
    searched.meta[1::2].reshape(14, 18)[5:9, 1:9] = searched.stamp << STAMP_SHIFT  # its first two blocks
    before = Links.of(prices)
    after = LinkSearch((12, 16)).without_dead_ends(before, Region(bitmap, *quarters), searched)
    with np.errstate(invalid="ignore"):
        changed = np.argwhere(after.prices > before.prices).tolist()
    first = 2 * before.stride + 2  # the block of row 1, column 1; the next is that at its right
    assert changed == [[first, 3], [first + 1, 2]]
    assert after.prices[first, 3] == after.prices[first + 1, 2] == pytest.approx(4.0 + CLOSED)
