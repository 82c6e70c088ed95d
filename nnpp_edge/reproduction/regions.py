"""The paper's region, to the letter, and its controls: regions of the same area that no network
made.

A region is a set of blocks of the map, as many to a side as the network's answer has.
"""

import functools
import math
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from nnpp_edge.profiling.contest import Answer, priced
from nnpp_edge.profiling.plain_astar import build_graph, search
from nnpp_edge.runtime.arrays import Bool, Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.kernels.threshold import lowered
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.network.encoding import Frame
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.region.learned import RegionFinder
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.terrain.shards import planes_of

NETWORK = "network"
CORRIDOR = "corridor"
BAND = "straight band"
SHUFFLED = "shuffled weights"
CONTROLS = (CORRIDOR, BAND, SHUFFLED)


class NetworkPair(NamedTuple):
    """The two networks of a run."""

    paper: NetworkModel
    """Of the paper's method: A* in the region at td."""
    ours: NetworkModel
    """Of this toolkit's ``nnpp``."""


class PaperRegions:
    """Regions of one network on one map for one query, by the paper's rule (NNPP, section 4.3 and
    Fig. 10), and their controls.

    The map is averaged to the network's size. td is the greatest threshold at which start and goal
    lie in one piece of {p >= td}, where blocks that touch are one piece; the region is all of
    {p >= factor · td}, by the factor in the model's metadata. The network is run once, and nothing
    is widened or narrowed.
    """

    def __init__(self, cost: Float2D, query: Endpoints, model: NetworkModel) -> None:
        self.cost = cost
        self.query = query
        self.model = model.share()
        self.side = model.metadata.blocks
        self.grid = grid_of(cost)
        self.frame = Frame(*self.grid.shape, model.metadata.input_size)
        self.lookup = self.frame.lookup(self.side)
        self.finder = RegionFinder(self.side)
        self.inference_s = math.nan
        row_block, col_block = self.lookup
        self._ends = [(int(row_block[row]), int(col_block[col])) for row, col in query]
        self._count = 0

    def region(self, kind: str) -> Region:
        """The network's, or that of one of `CONTROLS`: where no network decides of as many blocks
        as the network's, which was asked for before.
        """
        if kind == NETWORK:
            return self._by_network()
        if kind == SHUFFLED:
            return self._shuffled.region(NETWORK)
        return self._nearest_blocks(self._ends if kind == BAND else self._coarse_path())

    def _by_network(self) -> Region:
        """The region at the model's factor on td."""
        self.model.set_map(planes_of(self.grid, self.frame))
        start, goal = map(self.frame.place, self.query)
        began = time.perf_counter()
        probability = self.model.answer(start, goal, anew=True)
        self.inference_s = time.perf_counter() - began
        self.finder.read(probability)
        td = self.finder.threshold(*self._ends)
        threshold = min(td, lowered(td, self.model.metadata.region_factor))
        blocks = self.finder.levels >= threshold
        self._count = int(blocks.sum())
        return self._of(blocks)

    @functools.cached_property
    def _shuffled(self) -> "PaperRegions":
        """Regions of the network with shuffled weights on the same map."""
        return PaperRegions(self.cost, self.query, shuffled(self.model.path))

    def _of(self, blocks: Bool) -> Region:
        """The region of some of the blocks, (B, B) bool."""
        return Region(np.pad(blocks, (0, 1)).astype(np.int32), *self.lookup, 1)

    def _coarse_path(self) -> list[Cell]:
        """The cheapest path over the map averaged to blocks; start and goal where there is none."""
        cost, blocked = planes_of(self.grid, Frame(*self.grid.shape, self.side))
        passable = np.where(blocked < 1.0, np.minimum(cost, np.float32(0.999)), np.float32(np.inf))
        return search(build_graph(passable), *self._ends) or self._ends

    def _nearest_blocks(self, line: Sequence[Cell]) -> Region:
        """The blocks nearest to a line through blocks; all of the line in any case."""
        rows, cols = np.indices((self.side, self.side))
        distance = np.full(rows.shape, np.inf)
        # the distance of every block to the nearest leg of the line
        for (row, col), (next_row, next_col) in pairwise([*line, line[-1]]):
            down = next_row - row
            across = next_col - col
            along = (rows - row) * down + (cols - col) * across
            share = np.clip(along / max(down**2 + across**2, 1), 0.0, 1.0)
            to_leg = np.hypot(rows - row - share * down, cols - col - share * across)
            distance = np.minimum(distance, to_leg)
        distance[tuple(np.transpose(line))] = -1.0
        order = np.argsort(distance, axis=None, kind="stable")
        chosen = np.zeros(distance.size, bool)
        chosen[order[: max(self._count, len(set(line)))]] = True
        return self._of(chosen.reshape(distance.shape))


def grid_of(cost: Float2D) -> Grid:
    """A map with the paper's step costs."""
    return Grid.of(cost, StepModel.of("paper"))


def best_path(grid: Grid, query: Endpoints, region: Region | None = None) -> Answer:
    """The cheapest path in a region, or on the whole map."""
    found = astar(grid, *query, Workspace(len(grid.weights)), region=region)
    return priced(grid, found.path, region)


@functools.cache
def shuffled(network_file: Path) -> NetworkModel:
    """The network with the weights of each layer in a random order, always the same one."""
    import onnx
    from onnx import numpy_helper

    network = onnx.load(network_file)
    rng = np.random.default_rng(1)
    for weights in network.graph.initializer:
        if len(weights.dims) == 4:
            values = numpy_helper.to_array(weights)
            mixed = rng.permutation(values.ravel()).reshape(values.shape)
            weights.CopyFrom(numpy_helper.from_array(mixed, weights.name))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "shuffled.onnx"
        onnx.save(network, path)
        return NetworkModel(path)
