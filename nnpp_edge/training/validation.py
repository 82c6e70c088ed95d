"""Validation by the metric that matters: the outcome of searches in the predicted region."""

from dataclasses import dataclass

import numpy as np

from nnpp_edge.model.network import Network, encode
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.arrays import Float32
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.kernels.threshold import lowered
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.network.encoding import Frame
from nnpp_edge.runtime.region.learned import RegionFinder
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.terrain.dataset import Samples

FACTORS = (1.0, 0.5, 0.25)
"""On the adaptive threshold, that a training is judged at."""


@dataclass(frozen=True)
class Judgement:
    """Means over the validation queries at one factor on the adaptive threshold."""

    factor: float
    success: float
    """Share of queries with a path inside the region."""
    gap: float
    """Mean excess of the path's cost over the optimum, of the queries that succeeded."""
    region_share: float
    """Mean share of the map that the region covers."""
    mm: float
    """Mean ratio of the optimal path's cells to the region's (the paper's ModelMetric)."""


class Validator:
    """Searches a fixed set of labelled queries in the network's regions, on the maps as the data
    set holds them.

    The maps' side is the network's or a multiple of it; the network is shown them averaged. Cells
    of which a part is impassable, on maps that the data set holds averaged, are passable at their
    mean cost: all queries are searched.
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
        self._shown = samples.averaged(spec.input_size)
        ends = (self._shown.query(query)[1:] for query in self.index)
        self.queries = np.stack([encode(spec, start, goal) for start, goal in ends])
        self.model = StepModel.of("paper", omega)
        self.workspace = Workspace((size + 2) ** 2)
        self.finder = RegionFinder(spec.blocks)
        self.lookup = Frame(size, size, spec.input_size).lookup(spec.blocks)
        self.optima = [self._search(query) for query in self.index]
        """Cost and number of cells of the optimal paths."""

    def judge(self, network: Network) -> list[Judgement]:
        """Search every validation query in the network's region, for each of `FACTORS`."""
        maps = self._shown.planes[self._shown.map_index[self.index]]
        answers = network.answers(maps, self.queries)
        return [self.judge_answers(answers, factor) for factor in FACTORS]

    def judge_answers(self, probabilities: Float32, factor: float) -> Judgement:
        """As `judge`, for probabilities (Q, B, B) in the order of `index`, at one factor."""
        rows = []
        answers = zip(self.index, probabilities, self.optima, strict=True)
        for query, probability, (optimum, cells) in answers:
            region = self._region(query, probability, factor)
            area = region.area()
            cost, _ = self._search(query, region)
            share = area / self.samples.planes[0, 0].size
            rows.append((cost / optimum - 1.0, share, cells / area))
        gaps, shares, mms = np.array(rows).T
        found = np.isfinite(gaps)
        gap = gaps[found].mean() if found.any() else np.inf
        return Judgement(factor, *map(float, (found.mean(), gap, shares.mean(), mms.mean())))

    def _region(self, query: int, probability: Float32, factor: float) -> Region:
        """The region at a factor on the adaptive threshold."""
        row_block, col_block = self.lookup
        ends = self._ends(query)
        start, goal = ((int(row_block[row]), int(col_block[col])) for row, col in ends)
        self.finder.read(probability)
        threshold = self.finder.threshold(start, goal)
        self.finder.mark(lowered(threshold, factor), start, goal)
        return self.finder.region(self.lookup)

    def _search(self, query: int, region: Region | None = None) -> tuple[float, int]:
        """Cost and number of cells of the cheapest path; inf if there is none."""
        planes = self.samples.planes[self.samples.map_index[query]]
        cost = np.minimum(planes[0].astype(np.float32), 254.0) / 255.0
        cost[planes[1] == 255] = np.inf
        grid = Grid.of(cost, self.model)
        path = astar(grid, *self._ends(query), self.workspace, region=region).path
        return grid.costs_of(path)[0], len(path)

    def _ends(self, query: int) -> Endpoints:
        """Start and goal, as cells of the data set's map."""
        start = np.rint(self.samples.start[query]).astype(int)
        goal = np.rint(self.samples.goal[query]).astype(int)
        return tuple(start.tolist()), tuple(goal.tolist())
