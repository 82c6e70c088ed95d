"""The planner: a map, a network and scratch memory, answering one query after another."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Bool, Float2D
from nnpp_edge.runtime.cells import Cell, as_cell
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.options import PlannerOptions, PlanOptions
from nnpp_edge.runtime.planners.on_map import OnMap, coarse_ground, one_at_a_time, split
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.planners.query import options_of
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.stopwatch import Work

if TYPE_CHECKING:
    from nnpp_edge.runtime.planners.tour import Tour
    from nnpp_edge.runtime.terrain.traversability import Traversability


class Planner(OnMap):
    """Plans on one map, many times. For one thread at a time; several planners may run in parallel.

    Parameters
    ----------
    cost : (H, W) float, or Ground
        With ``step_cost="paper"`` the traversability cost T in [0, 1], impassable where T >= 1 or
        NaN. With ``"length"`` a weight greater than 0, impassable where inf or NaN. Or a `Ground`,
        whose arrays are copied.
    cell_size_m : float
        Side of a cell, wanted with costs and a disc.
    **options : PlannerOptions
        What steps cost, for whom, and the network; see there.

    Raises
    ------
    InvalidMapError
        The map is not two-dimensional, is empty, holds a cost out of range, or is too large for the
        memory that is left.
    InvalidQueryError
        An option is of another kind, or out of range.

    Examples
    --------
    >>> import numpy as np
    >>> planner = Planner(np.full((20, 30), 0.2, np.float32))
    >>> plan = planner.plan((2, 3), (15, 27), method="astar")
    >>> plan.status, len(plan.path)
    (<Status.OK: 'OK'>, 25)
    >>> planner.update(5, 0, np.ones((1, 30)))  # a wall
    30
    >>> planner.plan((2, 3), (15, 27), method="astar").status
    <Status.NO_PATH: 'NO_PATH'>
    """

    @classmethod
    def of_elevation(
        cls,
        dem: Float2D,
        cell_size_m: float,
        traversability: "Traversability | None" = None,
        **options: Unpack[PlannerOptions],
    ) -> "Planner":
        """A planner of a map that has just arrived: costs and coarse levels are computed where a
        search reads them.

        Plans are those of ``Planner(traversability_cost(dem, …))``, but for ties, and that the
        network is shown means of a sample of the cells. Arguments are those of
        `Ground.of_elevation` and `PlannerOptions`; the elevations are copied, and changed by
        `update_elevation`. Errors as of the class.
        """
        own, rest = split(options)
        rest.setdefault("warn", True)
        return cls(Ground.of_elevation(dem, cell_size_m, traversability, **own), **rest)

    @classmethod
    def of_coarse(
        cls,
        dem: Float2D,
        cell_size_m: float,
        factor: int,
        traversability: "Traversability | None" = None,
        **options: Unpack[PlannerOptions],
    ) -> "Planner":
        """A planner of ground that is known coarsely, and finely where `update_elevation` has
        updated it.

        Start, goal, path and patches are counted in the fine cells. An unseen cell counts by its
        block's expected price, and never as checked: `Plan.known` says how far a path leads over
        cells that were seen.

        Parameters
        ----------
        dem : (H, W) float
            Mean elevation in metres of blocks of `factor` × `factor` cells, NaN where unknown.
        cell_size_m : float
            Side of a block.
        **options
            As for `of_elevation`, as errors are, and `prior`, see `Ground`; its network is the
            option `model`.
        """
        ground, rest = coarse_ground(dem, cell_size_m, factor, traversability, options)
        return cls(ground, **rest)

    @checked(InvalidQueryError)
    @one_at_a_time
    def prepare(self, *, landmarks: int = 0) -> None:
        """Compute costs once for this map, so that ``astar`` expands a fraction of the cells, for
        the same optimum.

        `landmarks` are cells spread over the map; 8, the most, serve well. Worth it for many
        queries on a map that stays, or whose cells only become dearer: a patch that makes a cell
        cheaper undoes it. Each takes one search of the whole map, several times an A*'s work, and 4
        bytes a cell. InvalidQueryError for more than 8, or steps that cost by their slope.
        """
        self._methods.astar.prepare(landmarks)

    @one_at_a_time
    def plan(self, start: Cell, goal: Cell, **options: Unpack[PlanOptions]) -> Plan:
        """A path from start to goal, (row, col); the options are `PlanOptions`.

        Where a region fails it is widened, then the whole map is searched: NO_PATH means that there
        is none.

        Raises
        ------
        InvalidQueryError
            Start or goal are not two integers, or there is no such method.
        ModelError
            ``nnpp`` was asked for and the model cannot be loaded.
        """
        work = Work()  # the looks at the arguments count
        asked = options_of(**options)
        refining = self._frees(asked.get("refine"))
        deadline = Deadline.within(asked.get("time_limit_s", math.inf))
        plan = self._on_grid(start, goal, asked, work, deadline)
        return self._refined(plan, refining, deadline)

    @checked(InvalidQueryError)
    @one_at_a_time
    def plan_via(
        self,
        start: Cell,
        goal: Cell,
        via: Sequence[Cell],
        *,
        best_order: bool = False,
        **options: Unpack[PlanOptions],
    ) -> "Tour":
        """A path from start to goal by way of other cells, all (row, col), in the order in which
        they are given.

        With `best_order` they, at most 12, are visited in the order that costs least, by the plans
        between each two; with ``astar`` these are the cheapest paths. The options are each leg's;
        the time is that of the whole tour: where it is up before the best order is known, the order
        given stays. The tour's plan has no path where one of the legs has none; its reason names
        it.

        Raises
        ------
        InvalidQueryError
            A place between lies outside the map or is impassable, too many are to be ordered, or as
            `plan`.
        """
        from nnpp_edge.runtime.planners.tour import tour

        asked = options_of(**options)
        refining = self._frees(asked.get("refine"))
        deadline = Deadline.within(asked.get("time_limit_s", math.inf))
        between = [as_cell(cell, f"via {at}") for at, cell in enumerate(via, 1)]
        stops = [as_cell(start, "start"), *between, as_cell(goal, "goal")]
        found = tour(
            lambda begin, end, direction=-1: self._on_grid(
                begin, end, asked, Work(), deadline, direction
            ),
            stops,
            self._state.grid,
            best_order=best_order,
            finish=lambda leg: self._refined(leg, refining, deadline),
            deadline=deadline,
        )
        return replace(found, plan=found.plan.over(self._state))

    @one_at_a_time
    def came_to(self, start: Cell) -> tuple[Bool, bool]:
        """Right after a `plan` from this cell with NO_PATH: the cells (H, W) to which its search
        came, and whether from the start; else from the goal.
        """
        memory = self._methods.exhausted
        return self._moves.came_to(self._state.grid, as_cell(start, "start"), memory)

    def _on_grid(
        self,
        start: Cell,
        goal: Cell,
        asked: PlanOptions,
        work: Work,
        deadline: Deadline,
        direction: int = -1,
    ) -> Plan:
        """The plan by the search alone."""
        wanted = None
        start_deg = asked.get("start_heading_deg")
        goal_deg = asked.get("goal_heading_deg")
        if start_deg is not None or goal_deg is not None:
            tolerance = asked.get("goal_tolerance_deg", 0.0)
            begin, wanted = self._moves.ends(start_deg, goal_deg, tolerance)
            direction = begin if direction < 0 else direction
        epsilon = asked.get("epsilon", math.inf)
        if not epsilon >= 0.0:
            raise InvalidQueryError(f"epsilon must be a number of at least 0, got {epsilon}")
        query = Query(
            as_cell(start, "start"), as_cell(goal, "goal"), epsilon, deadline, direction, wanted
        )
        method = Method(asked.get("method", Method.AUTO))
        keep = asked.get("keep_regions", False)
        return self._methods.plan(query, work, method, keep_regions=keep)

    def _refined(self, plan: Plan, refining: bool, deadline: Deadline) -> Plan:
        """The plan, freed from the grid if that is asked for."""
        if refining:
            return self._freed(plan, deadline)
        return plan if plan.states is None else plan.over(self._state)
