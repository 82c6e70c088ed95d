"""Answers to queries on a standing map: the method, the search, the line off the grid, the numbers along it."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, as_cell
from nnpp_edge.runtime.deadline import Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.choice import MethodChooser
from nnpp_edge.runtime.planners.map_planners import MapPlanners
from nnpp_edge.runtime.planners.plan import Method, Plan, Source
from nnpp_edge.runtime.planners.query import Found, Query, Wishes, Work, in_words, problem_with, told
from nnpp_edge.runtime.planners.refine import Refinement, Refiner
from nnpp_edge.runtime.planners.tour import Tour, tour
from nnpp_edge.runtime.search.astar import cost_field, costs_to_nearest
from nnpp_edge.runtime.tuning import NEAREST_STOPS


class Answers:
    """What `Planner` asks of one map. Serves one thread at a time.

    Parameters
    ----------
    state : MapState
        The map.
    model, ask_from
        As for `Planner`.
    """

    def __init__(self, state: MapState, model: str | Path | NetworkModel, ask_from: int) -> None:
        self._state, self._grid = state, state.grid
        self.planners = MapPlanners(state, model, network_from=ask_from)
        self._refiner = Refiner(state)
        self._choose_for(model)

    def _choose_for(self, model: str | Path | NetworkModel) -> None:
        self._chooser = MethodChooser(self._state.shape, model, self.planners.has_poses)

    def use_model(self, model: str | Path | NetworkModel) -> str | Path | NetworkModel:
        """Ask this network from now on, and give back what is to be remembered of it; ModelError as `Planner`."""
        loaded = self.planners.use_model(model)
        self._choose_for(loaded)
        return loaded

    def plan(self, start: Cell, goal: Cell, wishes: Wishes, work: Work) -> Plan:
        """As `Planner.plan`; `work` has counted the time since it was called."""
        refining, deadline = self._refining(wishes), Deadline.within(wishes.time_limit_s)
        return self._refined(self._found(start, goal, wishes, work, deadline), refining, wishes, deadline)

    def nearest(self, start: Cell, goals: Sequence[Cell], count: int, wishes: Wishes) -> list[tuple[int, Plan]]:
        """As `Planner.nearest`."""
        if not len(goals):
            raise InvalidQueryError("wanted at least one goal, got none")
        if not count >= 1:
            raise InvalidQueryError(f"count must be at least 1, got {count}")
        cells, begin = [as_cell(goal, "goal") for goal in goals], as_cell(start, "start")
        bounds = [self._grid.least_cost(begin, cell) for cell in cells]
        plans: dict[int, Plan] = {}
        for at in sorted(range(len(cells)), key=bounds.__getitem__):
            known = sorted(plan.cost for plan in plans.values())
            if len(known) >= count and known[count - 1] <= bounds[at]:
                break
            plans[at] = self.plan(begin, cells[at], wishes, Work())
        return sorted(plans.items(), key=lambda item: (not item[1].ok, item[1].cost))[:count]

    def via(self, start: Cell, goal: Cell, via: Sequence[Cell], best_order: bool, wishes: Wishes) -> Tour:
        """As `Planner.plan_via`."""
        refining, deadline = self._refining(wishes), Deadline.within(wishes.time_limit_s)
        between = [as_cell(cell, f"via {at}") for at, cell in enumerate(via, 1)]
        stops = [as_cell(start, "start"), *between, as_cell(goal, "goal")]
        memory = self.planners.astar.workspace
        nearest = partial(costs_to_nearest, self._grid, stops, NEAREST_STOPS, memory, deadline)
        found = tour(
            lambda begin, end: self._found(begin, end, wishes, Work(), deadline),
            stops,
            self._grid,
            best_order=best_order,
            at_least=self._grid.least_cost,
            nearest=nearest if wishes.method == Method.ASTAR else None,
            symmetric=self._grid.directed is None,
            finish=lambda leg: self._refined(leg, refining, wishes, deadline),
            deadline=deadline,
        )
        return replace(found, plan=found.plan.over(self._state, self._refiner.places(found.plan.waypoints)))

    def reach(self, start: Cell, within: float) -> Float2D:
        """As `Planner.reach`."""
        if not within >= 0.0:
            raise InvalidQueryError(f"within must be a number of at least 0, got {within}")
        cell = as_cell(start, "start")
        if problem := problem_with(self._grid, cell, cell):
            raise InvalidQueryError(f"start {cell} {in_words(problem)}")
        field = cost_field(self._grid, cell, self.planners.astar.workspace)
        field[field > within] = np.inf
        return field

    def _found(self, start: Cell, goal: Cell, wishes: Wishes, work: Work, deadline: Deadline) -> Plan:
        """What the search found, on the grid."""
        query = Query.of(start, goal, deadline, wishes.epsilon)
        planners, auto = self.planners, wishes.method == Method.AUTO
        chosen, choice = self._chooser.choose(wishes.method, query)
        if problem := problem_with(self._grid, query.start, query.goal):
            return Plan(problem, chosen, planner=chosen, reason=told(problem, query))
        checked = self._state.checked
        found: Found | None = None
        try:
            if auto and chosen is Method.ASTAR:
                found = planners.exact.find_briefly(query, work)
                if found is None:
                    chosen, choice = Method.CORRIDOR, f"{choice}, but the way is long"
            found = found or planners.planner(chosen, deadline).find(query, work)
        except OutOfTimeError:
            found = Found.too_late(Source.REGION)
        return found.plan(
            chosen,
            work,
            planner=chosen,
            choice=choice,
            keep_regions=wishes.keep_regions,
            costs_computed=self._state.costs_computed,
            checks=self._state.checked - checked,
            along=self._state.along(found.search.path),
        )

    def _refining(self, wishes: Wishes) -> Refinement | None:
        return Refinement.named(wishes.refine, self._grid)

    def _refined(self, plan: Plan, refining: Refinement | None, wishes: Wishes, deadline: Deadline) -> Plan:
        """The plan, freed from the grid if that is asked for."""
        return plan if refining is None else self._refiner.refined(plan, wishes.turning_radius_m, deadline)
