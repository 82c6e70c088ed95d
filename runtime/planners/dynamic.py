"""Planning towards one goal on a map that changes, from a start that moves.

NNPP, section 5.5, Tables 3 and 4: a path is planned, the robot follows it, the map changes, and the rest is planned
anew. Every method answers on the newest map; they differ in what they keep from one answer to the next.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, as_cell
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, shown
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.slope_cost import Mobility
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.dynamic_choice import DynamicChooser
from nnpp_edge.runtime.planners.map_planners import MapPlanners
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan, Source
from nnpp_edge.runtime.planners.query import Found, PlannerOptions, Query, Work, in_words, problem_with, told
from nnpp_edge.runtime.planners.refine import Refinement, Refiner
from nnpp_edge.runtime.planners.standing_path import Standing, StandingPath
from nnpp_edge.runtime.planners.turns import Turns, one_at_a_time
from nnpp_edge.runtime.search.astar import cost_field
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.runtime.tuning import UNSEEN_CHANGE


class DynamicPlanner:
    """Plans towards a goal, again and again, while the map changes and the start moves. Serves one thread at a time.

    After a call that was broken off, by a KeyboardInterrupt for one, the planner makes anew all but the map and the
    standing path; an `update` that was broken off is in the map whole or not at all.

    Parameters
    ----------
    cost, step_cost, omega, corner_cutting, model, vehicle, cell_size_m
        As for `Planner`.
    goal : (row, col)
        A cell of the map.
    method : str
        One of `DynamicMethod`. ``auto`` picks at each step what is the fastest there, and says why: exact A* for a
        goal nearby, unless the way there is long; D* Lite in the corridor that stands, if little has changed and that
        lies near the start; else a new corridor.
    also : sequence of str
        Other methods that `replan` may be asked for. What none of them needs is not kept.
    refine : str
        As for `Planner.plan`, of every plan.

    Raises
    ------
    InvalidMapError, InvalidQueryError, ConcurrentUseError
        As for `Planner`; or there is no such method; or the goal is outside the map.

    Examples
    --------
    >>> import numpy as np
    >>> planner = DynamicPlanner(np.full((20, 30), 0.2, np.float32), goal=(15, 27), method="dstar")
    >>> planner.move((2, 3))
    >>> len(planner.replan().path)
    25
    >>> planner.update(0, 10, np.ones((19, 2)))  # an obstacle
    38
    >>> planner.standing().footing
    <Footing.BLOCKED: 'blocked'>
    >>> planner.replan().ok
    True
    """

    @checked(InvalidQueryError)
    def __init__(
        self,
        cost: Float2D,
        goal: Cell,
        method: str = DynamicMethod.AUTO,
        *,
        also: Sequence[str] = (),
        step_cost: str = "paper",
        omega: float = PAPER_OMEGA,
        corner_cutting: bool = True,
        model: str | Path | NetworkModel = "edge",
        vehicle: Vehicle | None = None,
        cell_size_m: float | None = None,
        refine: str | None = None,
    ) -> None:
        ground = Ground(cost, cell_size_m=cell_size_m, vehicle=vehicle, step_cost=step_cost)
        self._begin(ground.state(omega, corner_cutting, tell_unknown=True), goal, method, also, model, refine)

    @classmethod
    @checked(InvalidQueryError)
    def of_elevation(
        cls,
        dem: Float2D,
        cell_size_m: float,
        goal: Cell,
        traversability: Traversability | None = None,
        method: str = DynamicMethod.AUTO,
        *,
        vehicle: Vehicle | None = None,
        cell_width_m: float | None = None,
        also: Sequence[str] = (),
        omega: float = PAPER_OMEGA,
        corner_cutting: bool = True,
        model: str | Path | NetworkModel = "edge",
        step_cost: str = "paper",
        mobility: Mobility | None = None,
        refine: str | None = None,
    ) -> "DynamicPlanner":
        """A planner of elevations, changed by `update_elevation`; with a vehicle, over its poses.

        Arguments are those of `Planner.of_elevation` and of the class.
        """
        ground = Ground.of_elevation(
            dem,
            cell_size_m,
            traversability,
            cell_width_m=cell_width_m,
            vehicle=vehicle,
            step_cost=step_cost,
            mobility=mobility,
        )
        given: PlannerOptions = {"omega": omega, "corner_cutting": corner_cutting, "model": model}
        return cls.on(ground, goal, method, also=also, refine=refine, **given)

    @classmethod
    @checked(InvalidQueryError)
    def on(
        cls,
        ground: Ground,
        goal: Cell,
        method: str = DynamicMethod.AUTO,
        *,
        also: Sequence[str] = (),
        omega: float = PAPER_OMEGA,
        corner_cutting: bool = True,
        model: str | Path | NetworkModel = "edge",
        refine: str | None = None,
    ) -> "DynamicPlanner":
        """A planner of a ground, whose map is copied; other arguments and errors as of the class."""
        planner = cls.__new__(cls)
        planner._begin(ground.state(omega, corner_cutting, tell_unknown=True), goal, method, also, model, refine)
        return planner

    def _begin(
        self,
        state: MapState,
        goal: Cell,
        method: str,
        also: Sequence[str],
        model: str | Path | NetworkModel,
        refine: str | None,
    ) -> None:
        self._turns = Turns()
        self.method = DynamicMethod.named(method)
        self.methods = frozenset((self.method, *map(DynamicMethod.named, also)))
        self._state, self._model, self._refinement = state, model, Refinement.named(refine, state.grid)
        self._start: Cell | None = None
        self._make_planners()
        self.set_goal(goal)

    def _make_planners(self, standing: Plan | None = None) -> None:
        """From the map's weights; of a standing path's plan nothing but its bound is forgotten."""
        self._planners = MapPlanners(self._state, self._model, unseen_change=UNSEEN_CHANGE)
        self._path = StandingPath(self._state)
        self._chooser = DynamicChooser(self._state, self._planners, self._path)
        self._refiner = Refiner(self._state)
        if not self._only_whole_map:
            self._planners.make_coarse_levels()
        if standing is not None and tuple(standing.path[-1]) == self._goal:
            with suppress(InvalidQueryError):  # it may not be walkable any more
                self._path.set(replace(standing, lower_bound=0.0))

    def _begin_anew(self) -> None:
        self._state.begin_anew()
        self._make_planners(self._path.plan)

    def __getstate__(self) -> dict[str, object]:
        """The map, the model, the ends, and the standing path: a copy begins anew with these."""
        kept = "_state", "_model", "_refinement", "_start", "_goal", "method", "methods", "standing_plan"
        return {name: getattr(self, name) for name in kept}

    def __setstate__(self, state: dict[str, object]) -> None:
        standing = cast("Plan | None", state.pop("standing_plan"))
        self.__dict__.update(state, _turns=Turns())
        self._make_planners(standing)

    @property
    def goal(self) -> Cell:
        """The cell that paths lead to."""
        return self._goal

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self._state.shape

    @property
    def state(self) -> MapState:
        """The map, its coarse levels and the log of its changes; to be changed by `update` alone."""
        return self._state

    @property
    def standing_plan(self) -> Plan | None:
        """The last plan that had a path."""
        return self._path.plan

    def is_passable(self, cell: Cell) -> bool:
        """Whether a cell of the map can be stood on."""
        return self._state.grid.is_passable(as_cell(cell, "cell"))

    @one_at_a_time
    def set_goal(self, goal: Cell) -> None:
        """Another goal; the standing path is forgotten. InvalidQueryError if it is outside the map."""
        cell = as_cell(goal, "goal")
        if not self._state.grid.holds(cell):
            raise InvalidQueryError(f"goal must lie inside the map of {self.shape}, got {cell}")
        self._goal = cell
        self._path.forget()

    @checked(InvalidQueryError)
    @one_at_a_time
    def update(self, row: int, col: int, patch: Float2D, *, seen: NDArray[np.bool_] | None = None) -> int:
        """As `Planner.update`, of the cells that were `seen`, (h, w): the number of cells that are other ones now."""
        change = self._state.update(row, col, patch, _mask(seen, patch))
        self._path.catch_up()
        return change.cells

    @checked(InvalidQueryError)
    @one_at_a_time
    def update_elevation(self, row: int, col: int, patch: Float2D, *, seen: NDArray[np.bool_] | None = None) -> int:
        """As `Planner.update_elevation`, of the cells that were `seen`: the number that may be other ones now."""
        change = self._state.update_elevation(row, col, patch, _mask(seen, patch))
        self._path.catch_up()
        return change.cells

    @one_at_a_time
    def first_blocked(self, path: NDArray[np.int32]) -> int:
        """Number of the first cell of a path (N, 2) inside the map that cannot be stepped on now; -1 if all can."""
        return self._state.grid.walk(path, 0, np.empty(len(path)))

    @one_at_a_time
    def reach(self, start: Cell | None = None) -> Float2D:
        """As `Planner.reach`, by default from where the robot is."""
        grid, start = self._state.grid, self._where() if start is None else as_cell(start, "start")
        if problem := problem_with(grid, start, start):
            raise InvalidQueryError(f"start {start} {in_words(problem)}")
        return cost_field(grid, start, self._planners.astar.workspace)

    def move(self, start: Cell) -> None:
        """The robot is in this cell now; InvalidQueryError if it is not a cell."""
        self._start = as_cell(start, "start")

    @one_at_a_time
    def standing(self) -> Standing:
        """How the last path stands on the map as it is now, for the robot where it is now."""
        return self._path.check(self._where())

    @checked(InvalidQueryError)
    @one_at_a_time
    def use_model(self, model: str | Path | NetworkModel) -> None:
        """As `Planner.use_model`; without effect where no method but ``astar`` and ``dstar`` is kept."""
        if not self._only_whole_map:
            self._model = self._planners.use_model(model)

    @one_at_a_time
    def prepare(self) -> None:
        """Do now what the first answer would else do: set D* Lite up, load the network and show it the map.

        The system is made to back all of the planner's arrays with memory, so that no later answer waits for that.
        """
        touch(self._planners.astar.workspace, self._path)
        if DynamicMethod.DSTAR in self.methods:
            self._planners.exact_mending.prepare(self._goal)
        if self._only_whole_map:
            return
        self._planners.coarse_to_fine.touch()
        if any(method.mends_regions for method in self.methods):
            self._planners.mender.prepare(self._goal)
        if any(method.base is Method.NNPP for method in self.methods):
            self._planners.prepare_network()

    @checked(InvalidQueryError)
    def replan(
        self, *, method: str | None = None, time_limit_s: float = math.inf, keep_regions: bool = False
    ) -> Plan:
        """A path from where the robot is to the goal, on the map as it is now.

        Parameters
        ----------
        method : str
            Instead of the planner's own; one of those that it was made for.
        time_limit_s : float
            After this the status is TIMEOUT. A network's answer is waited for.
        keep_regions : bool
            As for `Planner.plan`.

        Returns
        -------
        Plan
            Its path, where the status is OK, leads over passable cells of the newest map. Regions that fail are
            widened, then the whole map is searched: NO_PATH means that there is none.

        Raises
        ------
        InvalidQueryError
            There is no such method, or the start is not known (`move`).
        ModelError
            The network is needed and cannot be loaded.
        """
        return self._replan(Work(), method, time_limit_s, keep_regions)

    @one_at_a_time
    def _replan(self, work: Work, method: str | None, time_limit_s: float, keep_regions: bool) -> Plan:
        choice = ""
        wanted = self.method if method is None else DynamicMethod.named(method)
        if wanted not in self.methods:
            known = ", ".join(sorted(self.methods))
            raise InvalidQueryError(f"method must be one that the planner was made for ({known}), got {wanted}")
        query = Query.of(self._where(), self._goal, Deadline.within(time_limit_s))
        checked = self._state.checked
        problem = problem_with(self._state.grid, query.start, query.goal)
        if problem is not None:
            return Plan(problem, wanted.base, planner=wanted, reason=told(problem, query))
        try:
            if wanted is DynamicMethod.AUTO:
                found, wanted, choice = self._chooser.find(query, work)
            else:
                found = self._planners.dynamic(wanted, query.deadline).find(query, work)
        except OutOfTimeError:
            found = Found.too_late(Source.MAP if wanted.whole_map else Source.REGION)
        checks = self._state.checked - checked
        along = self._state.along(found.search.path)
        plan = found.plan(
            wanted.base, work, planner=wanted, choice=choice, keep_regions=keep_regions, checks=checks, along=along
        )
        if plan.ok:
            self._path.set(plan)
            self._chooser.answered()
        return self._refined(plan, query.deadline)

    @checked(InvalidQueryError)
    @one_at_a_time
    def refined(self, plan: Plan) -> Plan:
        """A plan whose path can be walked on the map as it is now, such as what is left of the standing one, with its
        way points where the planner was made with `refine`, and with the numbers along it.
        """
        return plan.over(self._state) if self._refinement is None else self._refined(plan, NEVER)

    def _refined(self, plan: Plan, deadline: Deadline) -> Plan:
        return plan if self._refinement is None else self._refiner.refined(plan, deadline=deadline)

    @property
    def _only_whole_map(self) -> bool:
        """Whether no method needs coarse levels."""
        return all(method.whole_map for method in self.methods)

    def _where(self) -> Cell:
        if self._start is None:
            raise InvalidQueryError("wanted a start (move) before the first plan, got none")
        return self._start


def _mask(seen: NDArray[np.bool_] | None, patch: Float2D) -> NDArray[np.bool_] | None:
    if seen is None:
        return None
    if not isinstance(seen, np.ndarray) or seen.dtype != np.bool_ or seen.shape != np.shape(patch):
        raise InvalidMapError(f"seen must be {np.shape(patch)} truth values, got {shown(seen)}")
    return np.ascontiguousarray(seen)
