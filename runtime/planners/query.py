"""One query on its way through a planner's stages."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.planners.plan import Plan


@dataclass(slots=True)
class Query:
    """What was asked, and what answering it has taken so far."""

    start: Cell
    goal: Cell
    corner_cutting: bool
    deadline: float
    cancelled: Callable[[], bool] | None
    epsilon: float
    by: str
    """Name of the planner that is asked."""
    reason: str
    """Why that one, if it was picked."""
    account: str = ""
    """How the search was made, where there was a choice."""
    expansions: int = 0
    threshold: float = math.nan
    """The adaptive threshold, once the network was asked."""
    network_region: Region | None = None
    """The network's region at it."""
    timings: dict[str, float] = field(default_factory=dict)
    _mark: float = field(default_factory=time.perf_counter)

    apart: int = field(init=False)
    """Cells between start and goal, as the king moves."""

    def __post_init__(self) -> None:
        """Measure the distance."""
        self.apart = max(abs(self.start[0] - self.goal[0]), abs(self.start[1] - self.goal[1]))

    def suffices(self, plan: Plan) -> bool:
        """Whether a plan need not be improved: it is out of time, or close enough to the bound asked for."""
        return plan.status is not Status.OK or plan.cost <= (1.0 + self.epsilon) * plan.lower_bound

    def lap(self, stage: str) -> None:
        """Book the time since the last call."""
        now = time.perf_counter()
        self.timings[stage] = self.timings.get(stage, 0.0) + 1e3 * (now - self._mark)
        self._mark = now


def as_cell(cell: Cell, name: str) -> Cell:
    """Two whole numbers; InvalidQueryError if it is anything else."""
    try:
        row, col = cell
        if int(row) == row and int(col) == col:
            return int(row), int(col)
    except (TypeError, ValueError):
        pass
    raise InvalidQueryError(f"{name} must be two whole numbers (row, col), got {cell!r}")


def problem_with(grid: Grid, start: Cell, goal: Cell) -> Status | None:
    """What forbids planning between two cells, if anything does: one lies outside the map, or is impassable."""
    for cell, outside, blocked in (
        (start, Status.START_OUTSIDE_MAP, Status.START_BLOCKED),
        (goal, Status.GOAL_OUTSIDE_MAP, Status.GOAL_BLOCKED),
    ):
        if not (0 <= cell[0] < grid.rows and 0 <= cell[1] < grid.cols):
            return outside
        if not grid.is_passable(*cell):
            return blocked
    return None
