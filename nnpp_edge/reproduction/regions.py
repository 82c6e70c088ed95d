"""The paper's region, to the letter, and the regions that it has to be compared with: those that no network made.

A region is a set of blocks of the map, as many to a side as the network answers with.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.files import temporary_folder
from nnpp_edge.profiling.harness import Harness
from nnpp_edge.reproduction.plain_astar import build_graph, search
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.network.encoding import Frame, map_planes
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import path_costs
from nnpp_edge.runtime.region.threshold import RegionFinder, probability_of
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.workspace import Workspace

NETWORK, CORRIDOR, BAND, SHUFFLED = "network", "corridor", "straight band", "shuffled weights"
CONTROLS = (CORRIDOR, BAND, SHUFFLED)
CONTROLS_NOTE = (
    "*corridor*, the blocks nearest to the path that a search over the map averaged to blocks finds, as many as the "
    "network's region has, so that MM is the same; *straight band*, as many blocks nearest to the line from start to "
    "goal; *shuffled weights*, the same network with the weights of each layer in a random order, its region by the "
    "same rule. Where a control meets a rule as well, the figure says nothing about the network"
)
Blocks = NDArray[np.bool_]
"""(B, B), which blocks of the map belong to a region."""


@dataclass(frozen=True)
class Networks:
    """The networks of an experiment."""

    paper: NetworkModel
    """Of the paper's method, A* in the region at td."""
    ours: NetworkModel
    """Of this toolkit's ``nnpp``."""

    @functools.cached_property
    def shuffled(self) -> NetworkModel:
        """`paper` with shuffled weights."""
        return shuffled(self.paper)

    @functools.cached_property
    def ours_shuffled(self) -> NetworkModel:
        """`ours` with shuffled weights."""
        return shuffled(self.ours)

    @property
    def named(self) -> str:
        """Both by name, for a page."""
        return f"`{self.paper.metadata.name}` in the paper's method, `{self.ours.metadata.name}` in ours"


class PaperRegions:
    """Regions of one network on one map, by the paper's rule (NNPP, section 4.3 and Fig. 10).

    The map is averaged to the network's size, once for each query. td is the greatest threshold at which start and
    goal lie in one piece of {p >= td}, blocks that touch being one piece; the region is all of {p >= td}. The network
    is asked once for a query, and nothing is widened or narrowed.
    """

    def __init__(self, cost: Float2D, model: NetworkModel) -> None:
        self.cost, self.model, metadata = cost, model.share(), model.metadata
        self.grid = Grid.of(cost, StepModel.of("paper"))
        self.frame = Frame(self.grid.rows, self.grid.cols, metadata.input_size)
        self.lookup = self.frame.lookup(metadata.blocks)
        self.finder = RegionFinder(metadata.blocks)

    def find(self, query: Endpoints) -> tuple[Region, dict[str, float]]:
        """The region, and how many seconds each stage took: ``view``, ``inference``, ``threshold``."""
        harness = Harness()
        view_s, _ = harness.timed(lambda: self._show(query))
        inference_s, probability = harness.timed(lambda: self.model.run(anew=True))
        threshold_s, region = harness.timed(lambda: self._at_td(probability, query))
        return region, {"view": view_s, "inference": inference_s, "threshold": threshold_s}

    def probability(self, query: Endpoints) -> tuple[Float2D, float]:
        """The network's answer, (B, B) float32, and the adaptive threshold td as a probability."""
        self.find(query)
        start, goal = (block_of(self.lookup, cell) for cell in query)
        return self.model.run().copy(), probability_of(self.finder.threshold(start, goal))

    def _show(self, query: Endpoints) -> None:
        self.model.set_map(planes_of(self.grid, self.frame))
        self.model.set_query(self.frame.place(query[0]), self.frame.place(query[1]))

    def _at_td(self, probability: Float2D, query: Endpoints) -> Region:
        start, goal = (block_of(self.lookup, cell) for cell in query)
        self.finder.read(probability)
        td = self.finder.threshold(start, goal)
        return region_of(self.finder.levels >= td, self.lookup)


def planes_of(grid: Grid, frame: Frame) -> NDArray[np.float32]:
    """(2, S, S) mean cost and share of impassable cells of a map, averaged as the frame says."""
    planes = np.empty((2, frame.size, frame.size), np.float32)
    map_planes(grid.weights, grid.stride, frame, *grid.as_traversability(), planes)
    return planes


def region_of(blocks: Blocks, lookup: tuple[NDArray[np.int32], NDArray[np.int32]]) -> Region:
    """Blocks as a region of the map whose rows and columns lie in the blocks of `lookup`."""
    return Region(np.pad(blocks, ((0, 1), (0, 1))).astype(np.int32), *lookup)


def block_of(lookup: tuple[NDArray[np.int32], NDArray[np.int32]], cell: Cell) -> Cell:
    """The block that a cell lies in."""
    return int(lookup[0][cell[0]]), int(lookup[1][cell[1]])


def corridor_region(grid: Grid, query: Endpoints, like: Region) -> Region:
    """A region without a network: around the path over the map averaged to blocks, as many blocks as `like` has.

    All of the path's blocks belong to it, even where that makes more.
    """
    lookup = like.row_block, like.col_block
    blocks = len(like.bitmap) - 1
    cost, blocked = planes_of(grid, Frame(*grid.shape, blocks))
    passable = np.where(blocked < 1.0, np.minimum(cost, np.float32(0.999)), np.float32(np.inf))
    start, goal = (block_of(lookup, cell) for cell in query)
    path = search(build_graph(passable), start, goal) or [start, goal]
    return _nearest_blocks(path, lookup, like)


def band_region(grid: Grid, query: Endpoints, like: Region) -> Region:
    """A straight band from start to goal over the grid, as many blocks as `like` has."""
    lookup = like.row_block, like.col_block
    return _nearest_blocks([block_of(lookup, cell) for cell in query], lookup, like)


def _nearest_blocks(
    line: Sequence[Cell], lookup: tuple[NDArray[np.int32], NDArray[np.int32]], like: Region
) -> Region:
    """The blocks nearest to a line through blocks, those on it first, as many as `like` has."""
    side = len(like.bitmap) - 1
    rows, cols = np.mgrid[:side, :side]
    distance = np.full((side, side), np.inf)
    for (row, col), (to_row, to_col) in zip(line, [*line[1:], line[-1]], strict=True):
        down, across = to_row - row, to_col - col
        share = ((rows - row) * down + (cols - col) * across) / max(down * down + across * across, 1)
        share = np.clip(share, 0.0, 1.0)
        distance = np.minimum(distance, np.hypot(rows - row - share * down, cols - col - share * across))
    for row, col in line:
        distance[row, col] = -1.0
    distance[rows > lookup[0][-1]] = distance[cols > lookup[1][-1]] = np.inf  # outside the map
    wanted = max(int(like.blocks().sum()), len(set(line)))
    chosen = np.zeros(side * side, bool)
    chosen[np.argsort(distance, axis=None, kind="stable")[:wanted]] = True
    return region_of(chosen.reshape(side, side), lookup)


def optimal_path(grid: Grid, query: Endpoints, region: Region | None = None) -> NDArray[np.int32] | None:
    """(N, 2) cells of the cheapest path in a region, or on the whole map; None if there is none."""
    path = astar(grid, *query, Workspace(len(grid.weights)), region=region).path
    return path if len(path) else None


@dataclass(frozen=True)
class Found:
    """What a search in one region came to, beside the optimum."""

    found: bool
    traverse_cost: float
    exact_traverse_cost: float
    excess: float
    """The path's cost over the optimum, less 1."""
    mm: float
    """Cells of the optimal path over those of the region (Eq. 6)."""
    share: float
    """Of the map's cells that belong to the region."""


def all_regions(maker: PaperRegions, query: Endpoints, shuffled: NetworkModel) -> dict[str, Region]:
    """The network's region by the paper's rule, and those of the controls, by the names in `CONTROLS`."""
    region, _ = maker.find(query)
    other, _ = PaperRegions(maker.cost, shuffled).find(query)
    makers = {CORRIDOR: corridor_region, BAND: band_region}
    return {
        NETWORK: region,
        **{name: make(maker.grid, query, region) for name, make in makers.items()},
        SHUFFLED: other,
    }


def compare_regions(
    cost: Float2D, query: Endpoints, network: NetworkModel, shuffled: NetworkModel
) -> dict[str, Found]:
    """What compiled searches come to in the network's region and in the controls', see `all_regions`."""
    maker = PaperRegions(cost, network)
    regions = all_regions(maker, query, shuffled)
    workspace = Workspace(len(maker.grid.weights))
    best = astar(maker.grid, *query, workspace).path
    optimum, _, exact_cc = path_costs(maker.grid, best)
    out = {}
    for name, each in regions.items():
        path_cost, _, cc = path_costs(maker.grid, astar(maker.grid, *query, workspace, region=each).path)
        area, excess = each.area(), path_cost / optimum - 1.0 if optimum else 0.0
        figures = cc, exact_cc, excess, len(best) / area, area / maker.grid.cells
        out[name] = Found(math.isfinite(path_cost), *figures)
    return out


@dataclass(frozen=True)
class RegionMeans:
    """Means over many queries; those of costs over the queries with a path in the region."""

    queries: int
    success: float
    cc: float
    exact_cc: float
    """Of the optimal paths, over all queries."""
    cc_increase: float
    excess: float
    mm: float
    mm_sd: float
    share: float


def region_means(found: Sequence[Found]) -> RegionMeans:
    """Means of what searches in regions of one kind came to."""
    solved = [each for each in found if each.found]
    cc, exact = (float(sum(getattr(e, name) for e in solved)) for name in ("traverse_cost", "exact_traverse_cost"))
    mms = [each.mm for each in found]
    return RegionMeans(
        queries=len(found),
        success=len(solved) / len(found),
        cc=cc / len(solved) if solved else math.inf,
        exact_cc=float(np.mean([each.exact_traverse_cost for each in found])),
        cc_increase=cc / exact - 1.0 if exact else (0.0 if solved else math.inf),
        excess=float(np.mean([each.excess for each in solved])) if solved else math.inf,
        mm=float(np.mean(mms)),
        mm_sd=float(np.std(mms)),
        share=float(np.mean([each.share for each in found])),
    )


def shuffled(model: NetworkModel, seed: int = 1) -> NetworkModel:
    """The network with the weights of each layer in a random order, the same for the same seed."""
    import onnx
    from onnx import numpy_helper

    network = onnx.load(model.path)
    rng = np.random.default_rng(seed)
    for weights in network.graph.initializer:
        if len(weights.dims) == 4:
            values = numpy_helper.to_array(weights)
            mixed = rng.permutation(values.ravel()).reshape(values.shape)
            weights.CopyFrom(numpy_helper.from_array(np.ascontiguousarray(mixed), weights.name))
    with temporary_folder() as folder:
        path = folder / "shuffled.onnx"
        path.write_bytes(network.SerializeToString())
        return NetworkModel(path)
