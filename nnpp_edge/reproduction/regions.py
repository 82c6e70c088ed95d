"""The paper's region, to the letter, and its controls: regions of the same area that no network
made.

A region is a set of blocks of the map, as many to a side as the network answers with.
"""

import functools
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.reproduction.plain import build_graph, search
from nnpp_edge.runtime.arrays import Float2D
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


class Networks(NamedTuple):
    paper: NetworkModel
    """Of the paper's method, A* in the region at td."""
    ours: NetworkModel
    """Of this toolkit's ``nnpp``."""


class PaperRegions:
    """Regions of one network on one map, by the paper's rule (NNPP, section 4.3 and Fig. 10).

    The map is averaged to the network's size, once for each query. td is the greatest threshold at
    which start and goal lie in one piece of {p >= td}, blocks that touch being one piece; the
    region is all of {p >= factor · td}, by the factor in the model's metadata. The network is run
    once for a query, and nothing is widened or narrowed.
    """

    def __init__(self, cost: Float2D, model: NetworkModel) -> None:
        self.cost = cost
        self.model = model.share()
        metadata = model.metadata
        self.grid = Grid.of(cost, StepModel.of("paper"))
        self.frame = Frame(self.grid.rows, self.grid.cols, metadata.input_size)
        self.lookup = self.frame.lookup(metadata.blocks)
        self.finder = RegionFinder(metadata.blocks)
        self.inference_s = math.nan
        """Of the last query."""

    def find(self, query: Endpoints) -> Region:
        """The region at the model's factor on td."""
        self.model.set_map(planes_of(self.grid, self.frame))
        ends = self.frame.place(query[0]), self.frame.place(query[1])
        began = time.perf_counter()
        probability = self.model.answer(*ends, anew=True)
        self.inference_s = time.perf_counter() - began
        self.finder.read(probability)
        td = self.finder.threshold(*_blocks(self.lookup, query))
        blocks = self.finder.levels >= min(td, lowered(td, self.model.metadata.region_factor))
        return Region(np.pad(blocks, ((0, 1), (0, 1))).astype(np.int32), *self.lookup)

    def controls(self, like: Region) -> dict[str, Callable[[Endpoints], Region]]:
        """Makers of the regions of `CONTROLS`, as many blocks as `like` has where no network
        decides.
        """
        shuffled_regions = PaperRegions(self.cost, shuffled(self.model.path))
        return {
            CORRIDOR: lambda query: _nearest_blocks(_coarse_path(self.grid, query, like), like),
            BAND: lambda query: _nearest_blocks(
                _blocks((like.row_block, like.col_block), query), like
            ),
            SHUFFLED: shuffled_regions.find,
        }


def all_regions(maker: PaperRegions, query: Endpoints) -> dict[str, Region]:
    """The network's region by the paper's rule, and those of the controls, by the names in
    `CONTROLS`.
    """
    region = maker.find(query)
    return {NETWORK: region} | {kind: make(query) for kind, make in maker.controls(region).items()}


def best_path(grid: Grid, query: Endpoints, region: Region | None = None) -> NDArray[np.int32]:
    """(N, 2) cells of the cheapest path in a region, or on the whole map; none if there
    is no path.
    """
    return astar(grid, *query, Workspace(len(grid.weights)), region=region).path


def _blocks(
    lookup: tuple[NDArray[np.int32], NDArray[np.int32]], cells: Sequence[Cell]
) -> list[Cell]:
    """The blocks that cells lie in."""
    return [(int(lookup[0][row]), int(lookup[1][col])) for row, col in cells]


def _coarse_path(grid: Grid, query: Endpoints, like: Region) -> list[Cell]:
    """The cheapest path over the map averaged to blocks; start and goal where there is none."""
    cost, blocked = planes_of(grid, Frame(*grid.shape, len(like.bitmap) - 1))
    passable = np.where(blocked < 1.0, np.minimum(cost, np.float32(0.999)), np.float32(np.inf))
    start, goal = _blocks((like.row_block, like.col_block), query)
    return search(build_graph(passable), start, goal) or [start, goal]


def _nearest_blocks(line: Sequence[Cell], like: Region) -> Region:
    """The blocks nearest to a line through blocks, those on it first, as many as `like` has."""
    side = len(like.bitmap) - 1
    rows, cols = np.mgrid[:side, :side]
    distance = np.full((side, side), np.inf)
    for (row, col), (to_row, to_col) in zip(line, [*line[1:], line[-1]], strict=True):
        down = to_row - row
        across = to_col - col
        share = ((rows - row) * down + (cols - col) * across) / max(
            down * down + across * across, 1
        )
        share = np.clip(share, 0.0, 1.0)
        distance = np.minimum(
            distance, np.hypot(rows - row - share * down, cols - col - share * across)
        )
    distance[tuple(np.transpose(line))] = -1.0
    distance[rows > like.row_block[-1]] = distance[cols > like.col_block[-1]] = (
        np.inf
    )  # outside the map
    bitmap = np.zeros_like(like.bitmap)
    wanted = max(int(like.blocks().sum()), len(set(line)))
    bitmap[
        np.unravel_index(np.argsort(distance, axis=None, kind="stable")[:wanted], distance.shape)
    ] = 1
    return Region(bitmap, like.row_block, like.col_block)


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
            weights.CopyFrom(numpy_helper.from_array(np.ascontiguousarray(mixed), weights.name))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "shuffled.onnx"
        path.write_bytes(network.SerializeToString())
        return NetworkModel(path)
