"""What a query asks, and what the searches for it find."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.cells import Cell, cell_of
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.options import PlanOptions
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan, Source
from nnpp_edge.runtime.robots.robot import Robot
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.stopwatch import Work

_REASONS = {
    Status.NO_PATH: "no path exists on the known map",
    Status.TIMEOUT: "the time limit was reached before a path was found",
}


options_of: Callable[..., PlanOptions] = checked(InvalidQueryError)(PlanOptions)
"""From keywords; InvalidQueryError for a value of another kind."""


class Found(NamedTuple):
    """The search that a method ended with, and where that was made."""

    search: Search
    source: Source
    cost: float = math.inf
    length: float = math.inf
    traverse_cost: float = math.inf
    lower_bound: float = 0.0
    region: Region | None = None
    """Where it was allowed to go; None for the whole map. Its bitmap is overwritten by later
    queries.
    """
    network_region: Region | None = None
    threshold: float = math.nan

    @classmethod
    def of(
        cls, grid: Grid, search: Search, source: Source, region: Region | None = None
    ) -> "Found":
        """Of a search of the map, or of a region of it."""
        path = search.path  # of a search: it lies on the map
        costs = grid.robot.price.costs_of(grid, path)
        bound = 0.0
        if search.status is Status.OK:
            # g is kept in float32: a refused cell's f may be too high by its rounding
            worth = float(grid.robot.price.worth(cell_of(path[0]), cell_of(path[-1])))
            bound = min(costs[0], search.refused_f * (1.0 - 1e-6) + worth)
        return cls(search, source, *costs, bound, region)

    def suffices(self, query: Query) -> bool:
        """Whether it need not be improved: it is close enough to the bound asked for, time is up,
        or there is no path even outside the region.
        """
        if self.search.status is Status.NO_PATH:
            return self.search.refused_f == math.inf
        if self.search.status is not Status.OK:
            return True
        # the bound is below 0 where energy is got back
        above = query.epsilon if self.lower_bound >= 0.0 else -query.epsilon
        return self.cost <= (1.0 + above) * self.lower_bound

    def plan(
        self,
        by: DynamicMethod,
        work: Work,
        state: MapState,
        checked_before: int = 0,
        *,
        choice: str = "",
        keep_regions: bool = False,
    ) -> Plan:
        """The finished plan, which owns its data; of a map of which so many poses had been checked
        before.
        """
        search = self.search
        path = np.ascontiguousarray(search.path[:, :2])
        states = search.path[:, 2] if search.path.shape[1] == 3 else None
        plan = Plan(
            search.status,
            Method(by.entry.keeps or by),
            self.source,
            path,
            self.cost,
            self.length,
            self.traverse_cost,
            self.lower_bound,
            work.expansions,
            threshold=self.threshold,
            planner=by,
            choice=choice,
            reason=_REASONS.get(search.status, ""),
            costs_computed=state.costs_computed,
            checks=state.grid.robot.stance.checks - checked_before,
            timings_ms=work.timings_ms,
            along=state.along(path),
            states=states,
            vehicle=state.vehicle,
            known=state.known_along(path),
        )
        work.stage_ends("path")  # the plan's own making counts
        work.timings_ms["total"] = work.total_ms()
        if not keep_regions:
            return plan
        return replace(
            plan,
            region=self.region and self.region.copy(),
            network_region=self.network_region and self.network_region.copy(),
        )


def problem_with(grid: Grid, start: Cell, goal: Cell) -> Status | None:
    """The reason not to plan between two cells, if there is one: one lies outside the map, or is
    impassable.
    """
    if not grid.holds(start):
        return Status.START_OUTSIDE_MAP
    if not grid.is_passable(start):
        return Status.START_BLOCKED
    if not grid.holds(goal):
        return Status.GOAL_OUTSIDE_MAP
    return None if grid.is_passable(goal) else Status.GOAL_BLOCKED


def told(problem: Status, query: Query, robot: Robot) -> str:
    """Which cell of a query is at fault and why, for people."""
    at_start = problem in (Status.START_OUTSIDE_MAP, Status.START_BLOCKED)
    cell = query.start if at_start else query.goal
    reason = robot.stance.why_blocked(cell) if problem.endswith("BLOCKED") else ""
    why = f": {reason}" if reason else ""
    return f"{'start' if at_start else 'goal'} {cell} {in_words(problem)}{why}"


def in_words(problem: Status) -> str:
    """In words, what is wrong with a cell, by what `problem_with` says of it."""
    return "lies outside the map" if problem.endswith("OUTSIDE_MAP") else "is impassable"
