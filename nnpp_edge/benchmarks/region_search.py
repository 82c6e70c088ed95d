"""What a search inside a region costs, beside one of the whole map, and on maps of any size around it.

`python -m nnpp_edge.benchmarks.region_search` prints both figures as JSON.
"""

import json
from collections.abc import Callable, Sequence

import numpy as np

from nnpp_edge.profiling.harness import Harness
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.search.astar import Search, astar, cost_field
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.traversability import traversability_cost
from nnpp_edge.terrain.synthetic import synthetic_terrain

_BLOCK = 4
"""Cells on a side of what one entry of a region's bitmap covers."""


def _map(size: int, seed: int) -> Float2D:
    heights = synthetic_terrain(np.random.default_rng(seed), size, 20.0)
    return np.minimum(traversability_cost(heights, 20.0, warn=False), np.float32(0.99))


def _near_the_best(cost: Float2D, ends: Endpoints, share: float) -> Region:
    """The blocks through which the cheapest paths lead, as many as make up that share of the map."""
    grid = Grid.of(cost, StepModel.of("paper"))
    scratch = Workspace(len(grid.weights))
    through = cost_field(grid, ends[0], scratch) + cost_field(grid, ends[1], scratch)
    rows, cols = (side // _BLOCK for side in cost.shape)
    blocks = through[: rows * _BLOCK, : cols * _BLOCK].reshape(rows, _BLOCK, cols, _BLOCK).min(axis=(1, 3))
    inside = (blocks <= np.quantile(blocks, share)).astype(np.int32)
    row_block, col_block = (np.arange(side, dtype=np.int32) // _BLOCK for side in cost.shape)
    return Region(inside, row_block, col_block)


def _embedded(region: Region, at: int, size: int) -> Region:
    """The same cells as a region of a larger map, in which they lie `at` cells from its rim."""
    first, side = at // _BLOCK, region.bitmap.shape[0]
    bitmap = np.zeros((size // _BLOCK, size // _BLOCK), np.int32)
    bitmap[first : first + side, first : first + side] = region.bitmap
    blocks = np.arange(size, dtype=np.int32) // _BLOCK
    return Region(bitmap, blocks, blocks)


def _search(
    grid: Grid, ends: Endpoints, scratch: Workspace, region: Region | None = None
) -> Callable[[None], Search]:
    return lambda _: astar(grid, *ends, scratch, region=region)


def _in_turns(searches: Sequence[Callable[[None], Search]], rounds: int) -> tuple[list[float], list[int]]:
    """Median seconds of each search, and its expansions."""
    calls = {str(at): search for at, search in enumerate(searches)}
    (records,) = Harness().measure(calls, [None], repeats=rounds, warm_up=[None])
    found = list(records.values())
    return [record.median_s for record in found], [record.results[0].expansions for record in found]


def per_expansion(size: int = 512, share: float = 0.05, maps: int = 5, rounds: int = 21) -> dict[str, float]:
    """Nanoseconds for each cell expanded on whole maps and in regions of that share of them."""
    ns: list[tuple[float, float]] = []
    for seed in range(maps):
        cost = _map(size, seed)
        ends = ((size // 8, size // 8), (size - size // 8, size - size // 6))
        region = _near_the_best(cost, ends, share)
        grid = Grid.of(cost, StepModel.of("paper"))
        scratch = Workspace(len(grid.weights))
        searches = [_search(grid, ends, scratch), _search(grid, ends, scratch, region)]
        seconds, expansions = _in_turns(searches, rounds)
        ns.append((1e9 * seconds[0] / expansions[0], 1e9 * seconds[1] / expansions[1]))
    whole, inside = np.median(ns, axis=0)
    return {"whole_map_ns": float(whole), "region_ns": float(inside), "ratio": float(inside / whole)}


def by_map_size(small: int = 1024, large: int = 4096, maps: int = 3, rounds: int = 21) -> dict[str, float]:
    """Milliseconds for the same region's search on a map and on a larger one around it."""
    ms: list[tuple[float, float]] = []
    for seed in range(maps):
        cost = _map(small, seed)
        ends = ((small // 8, small // 8), (small - small // 8, small - small // 6))
        region = _near_the_best(cost, ends, 0.05)
        at = (large - small) // 2
        around = np.full((large, large), 0.3, np.float32)
        around[at : at + small, at : at + small] = cost
        moved = ((ends[0][0] + at, ends[0][1] + at), (ends[1][0] + at, ends[1][1] + at))
        grids = [Grid.of(each, StepModel.of("paper")) for each in (cost, around)]
        scratch = [Workspace(len(grid.weights)) for grid in grids]
        wide = _embedded(region, at, large)
        searches = [_search(grids[0], ends, scratch[0], region), _search(grids[1], moved, scratch[1], wide)]
        seconds, expansions = _in_turns(searches, rounds)
        assert expansions[0] == expansions[1]
        ms.append((1e3 * seconds[0], 1e3 * seconds[1]))
    first, second = np.median(ms, axis=0)
    return {f"{small}_ms": float(first), f"{large}_ms": float(second), "ratio": float(second / first)}


if __name__ == "__main__":
    print(json.dumps({"per_expansion": per_expansion(), "by_map_size": by_map_size()}, indent=1))
