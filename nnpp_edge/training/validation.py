"""Validation by the metric that matters: the outcome of searches in the predicted region."""

import math
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from queue import SimpleQueue
from statistics import fmean
from typing import TypeVar

import numpy as np

from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.outcome import outcome
from nnpp_edge.runtime.arrays import Float32s
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.kernels.threshold import lowered
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.network.encoding import Frame
from nnpp_edge.runtime.region.learned import RegionFinder
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.terrain.dataset import Samples

T = TypeVar("T")
Scratch = tuple[Workspace, RegionFinder]
"""Memory of one thread's searches."""


@dataclass(frozen=True)
class Judgement:
    """Means over the validation queries; what is counted is defined in `nnpp_edge.outcome`."""

    factor: float
    """On the adaptive threshold: in training, that at which planners use the network
    (`ARCHITECTURES`).
    """
    success: float
    """Share of queries that are found: with a path inside the region."""
    gap: float
    """Mean gap of those."""
    region_share: float
    """Mean share of the map that the region covers."""
    mm: float
    """Mean MM."""
    score: float
    """Mean of gap and region's share together, a query that is not found counted as a search of
    the whole map; less is better. The best weights are chosen by it.
    """


class Validator:
    """Searches a fixed set of labelled queries in the network's regions, on the maps as the data
    set holds them.

    The maps' side is the network's or a multiple of it; the network is shown them averaged. Cells
    of which a part is impassable, on maps that the data set holds averaged, are passable at their
    mean cost: all queries are searched. The region is the network's own (`reproduction.regions`),
    before any widening or narrowing.
    """

    def __init__(
        self,
        samples: Samples,
        spec: Spec,
        omega: float,
        most: int = 256,
    ) -> None:
        size = samples.planes.shape[-1]
        self.samples = samples
        self.index = np.linspace(0, len(samples) - 1, min(most, len(samples))).astype(int)
        self.shown = samples.averaged(spec.input_size).pick(self.index)
        """The queries as the network is shown them."""
        self.model = StepModel.of("paper", omega)
        self.lookup = Frame(size, size, spec.input_size).lookup(spec.blocks)
        self._scratch = SimpleQueue[Scratch]()
        for _ in os.sched_getaffinity(0):
            self._scratch.put((Workspace((size + 2) ** 2), RegionFinder(spec.blocks)))
        self.optima = self._in_threads(self._optimum, range(len(self.index)))
        """Cost and number of cells of the optimal paths."""

    def judge(self, network: Network) -> Judgement:
        """Search every validation query in the network's region."""
        shown = self.shown
        ends = np.stack([shown.start, shown.goal], 1)
        answers = network.answers(shown.planes[shown.map_index], ends)
        return self.judge_answers(answers, network.spec.region_factor)

    def judge_answers(self, probabilities: Float32s, factor: float) -> Judgement:
        """As `judge`, for probabilities (Q, B, B) in the order of `index`."""

        def of_query(at: int, scratch: Scratch) -> dict[str, float]:
            workspace, finder = scratch
            optimum, cells = self.optima[at]
            grid, ends = self._query(at)
            row_block, col_block = self.lookup
            start, goal = ((int(row_block[row]), int(col_block[col])) for row, col in ends)
            finder.read(probabilities[at])
            finder.mark(lowered(finder.threshold(start, goal), factor), start, goal)
            region = finder.region(self.lookup)
            path = astar(grid, *ends, workspace, region=region).path
            return outcome(grid.costs_of(path)[0], optimum, cells, region)

        rows = self._in_threads(of_query, range(len(self.index)))
        gaps = [each["gap"] for each in rows if each["found"]]
        scores = [each["gap"] + each["share"] if each["found"] else 1.0 for each in rows]
        return Judgement(
            factor,
            success=fmean(each["found"] for each in rows),
            gap=fmean(gaps) if gaps else math.inf,
            region_share=fmean(each["share"] for each in rows),
            mm=fmean(each["mm"] for each in rows),
            score=fmean(scores),
        )

    def _optimum(self, at: int, scratch: Scratch) -> tuple[float, int]:
        """Cost and number of cells of the cheapest path on the whole map."""
        grid, ends = self._query(at)
        path = astar(grid, *ends, scratch[0]).path
        return grid.costs_of(path)[0], len(path)

    def _query(self, at: int) -> tuple[Grid, Endpoints]:
        """The map of a query, as the data set holds it, and the cells of start and goal."""
        query = self.index[at]
        planes = self.samples.planes[self.samples.map_index[query]]
        cost = np.minimum(planes[0].astype(np.float32), 254.0) / 255.0
        cost[planes[1] == 255] = np.inf
        ends = np.rint([self.samples.start[query], self.samples.goal[query]]).astype(int)
        start, goal = ends.tolist()
        return Grid.of(cost, self.model), (tuple(start), tuple(goal))

    def _in_threads(self, work: Callable[[int, Scratch], T], queries: Iterable[int]) -> list[T]:
        """The work on each query, in their order, shared between the cores."""

        def run(query: int) -> T:
            scratch = self._scratch.get()
            try:
                return work(query, scratch)
            finally:
                self._scratch.put(scratch)

        with ThreadPoolExecutor(self._scratch.qsize()) as pool:
            return list(pool.map(run, queries))
