"""What the answers of passage networks are worth: searches by them, and whether their chances come true."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from nnpp_edge.calibrate.chances import LINKS, POSES, came_true
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.network.passage import unsuited
from nnpp_edge.runtime.network.passage_model import PassageModel
from nnpp_edge.runtime.planners.corridor import CorridorPlanner
from nnpp_edge.runtime.planners.exact import ExactPlanner
from nnpp_edge.runtime.planners.link_descent import LinkDescent
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import AStarSearcher
from nnpp_edge.runtime.region.looked import LookedMap
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.runtime.tuning import NETWORK_CORRIDOR, WIDENED_NETWORK_CORRIDOR
from nnpp_edge.training.passage_batches import PassageBatch, PassageMaps

APART, PAIRS = 0.5, 40
"""Of start and goal, at least, in shares of the map's side; and pairs of cells that are tried on a map."""
Chances = NDArray[np.floating]
BINS = 10
"""Of chances, as wide as each other."""


@dataclass(frozen=True)
class SearchFigures:
    """Of searches by the prices of one network, each on a map none of whose poses has been checked."""

    queries: int
    success: float
    """Share of the first regions that held a path."""
    gap: float
    """Mean of what paths cost more than the optimum, as a share of it."""
    checks: float
    """Mean number of checked poses, those of wider regions and whole maps counted."""
    exact_checks: float
    """The same of the exact search."""


def search_figures(models: list[Path], maps: PassageMaps, count: int) -> list[SearchFigures]:
    """What each model's searches come to on the first map of each of the first `count` vehicles, the same queries.

    Vehicles out of the range that planners take, at whose edges networks are trained too, are left out.
    """
    rows: list[list[tuple[bool, float, int, int]]] = [[] for _ in models]
    networks = [PassageModel(path) for path in models]
    for k in range(min(count, len(maps))):
        heights, vehicle = maps.ground(k)
        if unsuited(vehicle, (1.0, 1.0)):
            continue
        if (asked := _query(heights, vehicle, np.random.default_rng(k))) is None:
            continue
        query, cost, checks = asked
        for network, own in zip(networks, rows, strict=True):
            found, checked = _by_network(heights, vehicle, network, query)
            own.append((found.source is Source.REGION, found.cost / cost - 1.0, checked, checks))
    return [SearchFigures(len(own), *(np.mean(own, 0).tolist() if own else [math.nan] * 4)) for own in rows]


def _state(heights: Float2D, vehicle: Vehicle) -> MapState:
    return MapState.of_elevation(heights, (1.0, 1.0), Traversability(), StepModel.of("paper"), vehicle=vehicle)


def _query(heights: Float2D, vehicle: Vehicle, rng: np.random.Generator) -> tuple[Query, float, int] | None:
    """Cells far apart with a path between them, what it costs, and the poses that the exact search checks."""
    for _ in range(PAIRS):
        start, goal = (_cell(rng, heights.shape) for _ in range(2))
        query = Query(start, goal)
        if query.apart < APART * max(heights.shape):
            continue
        state = _state(heights, vehicle)
        found = ExactPlanner(AStarSearcher(state)).find(query, Work(), Source.FALLBACK)
        if found.search.status is Status.OK:
            return query, found.cost, state.checked
    return None


def _cell(rng: np.random.Generator, shape: tuple[int, ...]) -> Cell:
    return int(rng.integers(shape[0])), int(rng.integers(shape[1]))


def _by_network(heights: Float2D, vehicle: Vehicle, network: PassageModel, query: Query) -> tuple[Found, int]:
    """What the corridor finds by a network's prices, and how many poses that took."""
    state = _state(heights, vehicle)
    searcher = AStarSearcher(state)
    descent = LinkDescent(LookedMap(state, network), searcher.workspace)
    widths = NETWORK_CORRIDOR, WIDENED_NETWORK_CORRIDOR
    found = CorridorPlanner(descent, searcher, ExactPlanner(searcher), widths).find(query, Work())
    return found, state.checked


def reliability(answers: list[NDArray[np.float32]], parts: list[PassageBatch]) -> dict[str, list[tuple[float, ...]]]:
    """Which chances came true: by ``pose`` and ``link``, rows of mean chance said, share that did, and weight.

    `answers` are (N, 16, R + 2, C + 2) logits of the N maps of each part's one vehicle. Chances are told apart in
    tenths; a weight is a share of all.
    """
    said: dict[str, list[Chances]] = {"pose": [], "link": []}
    true: dict[str, list[Chances]] = {"pose": [], "link": []}
    for logits, part in zip(answers, parts, strict=True):
        chances = torch.sigmoid(torch.from_numpy(logits[..., 1:-1, 1:-1])).numpy()
        for name, which in (("pose", POSES), ("link", LINKS)):
            said[name].append(chances[:, which].ravel())
            true[name].append(came_true(part, which).ravel())
    return {name: _binned(np.concatenate(said[name]), np.concatenate(true[name])) for name in said}


def _binned(said: Chances, true: Chances) -> list[tuple[float, ...]]:
    bins = np.minimum((BINS * said).astype(np.int64), BINS - 1)
    count = np.bincount(bins, minlength=BINS)
    sums = [np.bincount(bins, each, BINS) for each in (said, true)]
    each = np.maximum(count, 1)
    table = np.column_stack([sums[0] / each, sums[1] / each, count / len(said)])
    return [tuple(round(float(value), 4) for value in row) for row in table]
