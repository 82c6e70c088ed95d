"""What the regions of the paper's experiments are made with: sets of blocks of the map, as many to
a side as the network's answer has.
"""

import functools
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from nnpp_edge.profiling.contest import Answer, priced
from nnpp_edge.runtime.arrays import Bool, Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import StepModel

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


def nearest_blocks(line: Sequence[Cell], count: int, side: int) -> Bool:
    """Which blocks of (B, B) are the `count` nearest to a line through blocks; all of the line in
    any case.
    """
    rows, cols = np.indices((side, side))
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
    chosen[order[: max(count, len(set(line)))]] = True
    return chosen.reshape(distance.shape)


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
