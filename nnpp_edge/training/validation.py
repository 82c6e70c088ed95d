"""Validation by the metric that matters: what a search in the predicted region comes to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from nnpp_edge.model.network import Network, encode
from nnpp_edge.model.registry import Spec
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

    def __init__(self, samples: Samples, spec: Spec, omega: float, most: int = 256) -> None:
        self.index = np.linspace(0, len(samples) - 1, min(most, len(samples))).astype(int)
        self.samples = samples
        self.spec = spec
        self._shown = samples.averaged(spec.input_size)
        self.queries = np.stack(
            [encode(spec, self._shown.start[q], self._shown.goal[q]) for q in self.index]
        )
        self.model = StepModel.of("paper", omega)
        size = samples.planes.shape[-1]
        self.workspace = Workspace((size + 2) ** 2)
        self.finder = RegionFinder(spec.blocks)
        self.lookup = Frame(size, size, spec.input_size).lookup(spec.blocks)
        self.optima = [self._search(q, None) for q in self.index]

    def _endpoints(self, query: int) -> Endpoints:
        """Start and goal, as cells of the data set's map."""
        ends = np.rint((self.samples.start[query], self.samples.goal[query])).astype(int)
        return tuple(ends[0].tolist()), tuple(ends[1].tolist())

    def _search(self, query: int, region: Region | None) -> tuple[float, int]:
        """Cost and number of cells of the cheapest path; inf if there is none."""
        planes = self.samples.planes[self.samples.map_index[query]]
        cost = np.minimum(planes[0].astype(np.float32), 254.0) / 255.0
        cost[planes[1] == 255] = np.inf
        grid = Grid.of(cost, self.model)
        found = astar(grid, *self._endpoints(query), self.workspace, region=region)
        return grid.costs_of(found.path)[0], len(found.path)

    @torch.no_grad()
    def probabilities(self, network: Network, batch: int = 32) -> NDArray[np.float32]:
        """(Q, B, B) the probabilities that the network gives for the validation queries."""
        network.eval()
        device = next(network.parameters()).device
        parts = []
        for at in range(0, len(self.index), batch):
            maps = self._shown.planes[self._shown.map_index[self.index[at : at + batch]]]
            planes = torch.from_numpy(maps).to(device).float() / 255.0
            query = torch.from_numpy(self.queries[at : at + batch]).to(device)
            parts.append(torch.sigmoid(network(planes, query).float()).cpu().numpy())
        return np.concatenate(parts)

    def judge(self, network: Network) -> list[Judgement]:
        """Search every validation query inside the region, for each of `FACTORS`."""
        return self.judge_probabilities(self.probabilities(network), FACTORS)

    def judge_probabilities(
        self, probabilities: NDArray[np.float32], factors: Sequence[float]
    ) -> list[Judgement]:
        """As `judge`, for probabilities (Q, B, B) that were computed elsewhere, in the order of
        `index`.
        """
        rows, cols = self.lookup
        out = []
        for factor in factors:
            gaps = []
            shares = []
            mms = []
            for query, probability, (optimum, cells) in zip(
                self.index, probabilities, self.optima, strict=True
            ):
                a, b = ((int(rows[row]), int(cols[col])) for row, col in self._endpoints(query))
                self.finder.read(probability)
                self.finder.mark(lowered(self.finder.threshold(a, b), factor), a, b)
                region = self.finder.region(self.lookup)
                cost, _ = self._search(query, region)
                if cost < float("inf"):
                    gaps.append(cost / optimum - 1.0)
                shares.append(region.area() / self.samples.planes.shape[-1] ** 2)
                mms.append(cells / region.area())
            means = (float(np.mean(figures)) for figures in (gaps or [float("inf")], shares, mms))
            out.append(Judgement(factor, len(gaps) / len(self.index), *means))
        return out
