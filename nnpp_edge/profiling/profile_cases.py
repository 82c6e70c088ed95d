"""The maps and queries of a profile: crops of terrain, synthetic ground where no file is large enough."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.profile_file import SAMPLE, Load
from nnpp_edge.profiling.suites import QUERIES_PER_MAP, SYNTHETIC, TerrainSuite, synthetic_cases
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.labels import Query, random_points

_SAMPLE_FILE, _SAMPLE_CELL_M = "moon_highlands.npz", 20.0
_LEAST_NEAR = 6.0
"""Cells between start and goal of the nearest queries."""
_TRIES = 50


@dataclass(frozen=True)
class Question:
    """A query, and whether budgets are judged by it."""

    start: tuple[int, int]
    goal: tuple[int, int]
    judged: bool

    @property
    def apart(self) -> int:
        """Cells between start and goal, as the king moves: what `auto` goes by."""
        return max(abs(self.start[0] - self.goal[0]), abs(self.start[1] - self.goal[1]))


@dataclass(frozen=True)
class Sheet:
    """A map with its questions."""

    terrain: str
    cost: NDArray[np.float32]
    questions: tuple[Question, ...]


class Ground:
    """Where a profile's maps come from. The same load gives the same maps on any machine.

    Raises
    ------
    TerrainError, InvalidQueryError
        A terrain file cannot be read.
    """

    def __init__(self, load: Load) -> None:
        self.load = load
        self.dems = [] if load.terrain == (SYNTHETIC,) else [_dem(name, load) for name in load.terrain]

    def source(self, size: int) -> str:
        """Name of the terrain that maps of this size come from."""
        return ", ".join(dict.fromkeys(dem.source.stem for dem in self._fitting(size))) or SYNTHETIC

    def sheets(self, name: str, size: int) -> Iterator[Sheet]:
        """Maps of one workload and size, without end; on each a share of the far and of the near questions."""
        load = self.load
        fitting = self._fitting(size)
        source = self.source(size)
        if fitting:
            suite = TerrainSuite(
                tuple(dem.source for dem in fitting), sizes=(size,), seed=load.seed, least_distance=load.min_distance
            )
            cases = suite.cases(fitting, name, size)
        else:
            cases = synthetic_cases(name, size, load.seed, load.min_distance)
        near_per_map = math.ceil(load.near * QUERIES_PER_MAP / load.queries)
        for at, case in enumerate(cases):
            rng = np.random.default_rng([load.seed, size, at])
            near = _near(rng, case.cost, near_per_map, load.min_distance * size)
            far = tuple(Question(start, goal, True) for start, goal in case.queries)
            yield Sheet(source, case.cost, far + near)

    def _fitting(self, size: int) -> Sequence[Dem]:
        return [dem for dem in self.dems if min(dem.elevation.shape) >= size]


def _dem(name: str, load: Load) -> Dem:
    if name == SAMPLE:
        path = Path(str(files("nnpp_edge.terrain") / "samples" / _SAMPLE_FILE))
        return read_dem(path).rescaled(load.rescale or _SAMPLE_CELL_M)
    dem = read_dem(Path(name), cell_size_m=load.cell_size)
    return dem if load.rescale is None else dem.rescaled(load.rescale)


def _near(
    rng: np.random.Generator, cost: NDArray[np.float32], wanted: int, farthest: float
) -> tuple[Question, ...]:  # fmt: skip
    """Questions whose distances are spread evenly on a logarithmic scale, up to `farthest` cells."""
    found: list[Question] = []
    if farthest <= _LEAST_NEAR:
        return ()
    for _ in range(_TRIES * wanted):
        if len(found) == wanted:
            break
        points = random_points(rng, cost, 1)
        distance = math.exp(rng.uniform(math.log(_LEAST_NEAR), math.log(farthest)))
        angle = rng.uniform(0.0, 2.0 * math.pi)
        if len(points) == 0:
            break
        start = int(points[0][0]), int(points[0][1])
        query: Query = (
            start,
            (round(start[0] + distance * math.sin(angle)), round(start[1] + distance * math.cos(angle))),
        )
        row, col = query[1]
        if 0 <= row < cost.shape[0] and 0 <= col < cost.shape[1] and cost[row, col] < 1.0:
            found.append(Question(*query, judged=False))
    return tuple(found)
