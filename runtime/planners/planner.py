"""The planner: a map, a network and scratch memory, answering one query after another."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, as_cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.slope_cost import Mobility
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.answers import Answers
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.planners.query import PlanOptions, Wishes, Work, options_of
from nnpp_edge.runtime.planners.tour import Tour
from nnpp_edge.runtime.planners.turns import Turns, one_at_a_time
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.runtime.tuning import NEAR


class Planner:
    """Plans on one map, many times. Serves one thread at a time; several planners may run in parallel.

    After a call that was broken off, by a KeyboardInterrupt for one, the planner makes anew all but the map itself
    (landmarks are gone); an `update` that was broken off is in the map whole or not at all.

    Parameters
    ----------
    cost : (H, W) float
        With ``step_cost="paper"`` the traversability cost T in [0, 1], impassable where T >= 1 or NaN. With
        ``"length"`` a weight greater than 0, impassable where inf or NaN.
    step_cost : str
        ``"paper"``: a step costs L + 255·omega·(T_i + T_j) (Eq. 2-4). ``"length"``: L × the mean weight.
    omega : float
        Weight of T per grey level; the paper's 0.011.
    corner_cutting : bool
        Whether a diagonal step may pass beside an impassable cell.
    model : str, Path or NetworkModel
        The network for ``nnpp``: a shipped model's name, a file, or one already loaded, which planners may share.
        It is loaded when first needed.
    ask_from : int
        Cells between start and goal from which on ``nnpp`` asks the network. Nearer goals A* has mostly found before
        it has answered, and is tried first.
    vehicle : Vehicle
        A disc (`radius_m`): it may not touch impassable cells, nor leave the map. A body needs `of_elevation`.
    cell_size_m : float
        Side of a cell, wanted with a vehicle alone.

    Raises
    ------
    InvalidMapError
        The map is not two-dimensional, is empty, holds a cost out of range, or is too large for the memory that is
        left.
    ConcurrentUseError
        From every method: another thread is in the middle of one.

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

    @checked(InvalidQueryError)
    def __init__(
        self,
        cost: Float2D,
        *,
        step_cost: str = "paper",
        omega: float = PAPER_OMEGA,
        corner_cutting: bool = True,
        model: str | Path | NetworkModel = "edge",
        ask_from: int = NEAR,
        vehicle: Vehicle | None = None,
        cell_size_m: float | None = None,
    ) -> None:
        ground = Ground(cost, cell_size_m=cell_size_m, vehicle=vehicle, step_cost=step_cost)
        self._begin(ground.state(omega, corner_cutting), model, ask_from)

    @classmethod
    @checked(InvalidQueryError)
    def of_elevation(
        cls,
        dem: Float2D,
        cell_size_m: float,
        traversability: Traversability | None = None,
        *,
        cell_width_m: float | None = None,
        lazy: bool = True,
        omega: float = PAPER_OMEGA,
        corner_cutting: bool = True,
        model: str | Path | NetworkModel = "edge",
        ask_from: int = NEAR,
        warn: bool = True,
        vehicle: Vehicle | None = None,
        step_cost: str = "paper",
        mobility: Mobility | None = None,
    ) -> "Planner":
        """A planner of a map that has just arrived: costs and coarse levels are computed where a search looks.

        Plans are those of ``Planner(traversability_cost(dem, …))``, but for ties, and that the network is shown means
        of a sample of the cells.

        Parameters
        ----------
        dem, cell_size_m, traversability, cell_width_m, warn
            As for `traversability_cost`. The elevations are copied; they are changed by `update_elevation`.
        lazy : bool
            Whether to compute costs only where they are looked at. Else all are computed now; plans are the same.
        omega, corner_cutting, model, ask_from
            As for `Planner`.
        vehicle : Vehicle
            The body whose poses decide where the path may go and what it costs, checked where a search looks; without
            one, the robot is a point.
        step_cost : str
            ``"paper"``, or what a way costs by the slope that it leads up or down: ``"time"``, ``"energy"``,
            ``"tobler"`` or ``"linear"``, see `map.slope_cost`. Where paths may go is decided by the traversability
            (or the poses) all the same. All costs of steps are then computed now, `lazy` or not, and `omega` is
            of no effect.
        mobility : Mobility
            Parameters of these models; ``time`` and ``energy`` have none by default.

        Raises
        ------
        InvalidMapError
            As for `traversability_cost`.
        InvalidQueryError
            There is no such step cost, or it needs a mobility.
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
        planner = cls.__new__(cls)
        planner._begin(ground.state(omega, corner_cutting, lazy=lazy, warn=warn), model, ask_from)
        return planner

    @classmethod
    @checked(InvalidQueryError)
    def on(
        cls,
        ground: Ground,
        *,
        lazy: bool = True,
        omega: float = PAPER_OMEGA,
        corner_cutting: bool = True,
        model: str | Path | NetworkModel = "edge",
        ask_from: int = NEAR,
    ) -> "Planner":
        """A planner of a ground, whose map is copied; other arguments and errors as of `of_elevation`."""
        planner = cls.__new__(cls)
        planner._begin(ground.state(omega, corner_cutting, lazy=lazy), model, ask_from)
        return planner

    def _begin(self, state: MapState, model: str | Path | NetworkModel, ask_from: int) -> None:
        self._turns = Turns()
        self._state, self._model, self._ask_from = state, model, ask_from
        self._make_answers()

    def _make_answers(self) -> None:
        self._answers = Answers(self._state, self._model, self._ask_from)

    def __getstate__(self) -> dict[str, object]:
        """The map and the model: copies, pickled or not, are to be prepared anew."""
        return {"_state": self._state, "_model": self._model, "_ask_from": self._ask_from}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state, _turns=Turns())
        self._make_answers()

    def _begin_anew(self) -> None:
        """Keep the map's weights alone: landmarks are gone, and the network is loaded again."""
        self._state.begin_anew()
        self._make_answers()

    @property
    def state(self) -> MapState:
        """The map, its coarse levels and the log of its changes; to be changed by `update` alone."""
        return self._state

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self._state.shape

    @checked(InvalidQueryError)
    @one_at_a_time
    def use_model(self, model: str | Path | NetworkModel) -> None:
        """Ask this network from now on. A name or a file is loaded and tried now; on an error the old one stays.

        Raises
        ------
        ModelError
            The model cannot be loaded.
        """
        self._model = self._answers.use_model(model)

    @one_at_a_time
    def load_network(self) -> None:
        """Do now what the first query of ``nnpp`` would: load the network and show it the map.

        Raises
        ------
        ModelError
            The model cannot be loaded.
        """
        self._answers.planners.prepare_network()

    @one_at_a_time
    def touch(self) -> None:
        """Have the system back the planner's arrays with memory now, rather than when they are first written to."""
        touch(self._answers.planners.astar.workspace)
        self._answers.planners.coarse_to_fine.touch()

    @checked(InvalidQueryError)
    @one_at_a_time
    def update(self, row: int, col: int, patch: Float2D) -> int:
        """Put new costs into the map.

        On a map of elevations what costs tell is a layer of its own: a cell costs the greater of that and of what its
        heights make of it, and is impassable where either says so. A body, and steps that cost
        by the slope, take no more from a cost below 1 than that the cell is not impassable by what was told.

        Parameters
        ----------
        row, col : int
            Where the patch's first cell goes.
        patch : (h, w) float
            New costs; must lie inside the map. NaN is impassable on a map of costs, and tells a map of elevations
            nothing.

        Returns
        -------
        int
            Number of cells that are other ones now.

        Raises
        ------
        InvalidMapError
            The patch does not lie inside the map, or holds a cost out of range. The map is as it was.
        InvalidQueryError
            Row or column is no whole number. The map is as it was.
        """
        return self._state.update(row, col, patch).cells

    @checked(InvalidQueryError)
    @one_at_a_time
    def update_elevation(self, row: int, col: int, patch: Float2D) -> int:
        """Put new elevations into a planner made by `of_elevation`.

        Parameters
        ----------
        row, col : int
            Where the patch's first cell goes.
        patch : (h, w) float
            Metres, NaN where unknown; must lie inside the map.

        Returns
        -------
        int
            Number of cells whose cost is another one now, those counted whose cost has not been computed yet.

        Raises
        ------
        InvalidMapError
            The patch does not lie inside the map, or the planner was made from costs. The map is as it was.
        InvalidQueryError
            Row or column is no whole number. The map is as it was.
        """
        return self._state.update_elevation(row, col, patch).cells

    @checked(InvalidQueryError)
    @one_at_a_time
    def prepare(self, *, landmarks: int = 0, goals: Sequence[Cell] = ()) -> None:
        """Compute costs once for this map, so that ``astar`` expands a fraction of the cells, for the same optimum.

        Worth it for many queries on a map that stays, or whose cells only become dearer: a patch that makes a
        cell cheaper undoes it. Each landmark and goal takes one search of the whole map, several times an A*'s
        work, and 4 bytes a cell.

        Parameters
        ----------
        landmarks : int
            Cells spread over the map, for queries between any two places; 8 serve well.
        goals : sequence of (row, col)
            Passable cells, for queries to (or from) them: the search then goes straight along the path.

        Raises
        ------
        InvalidQueryError
            More than 8 in all, or a goal that is outside the map or impassable.
        """
        self._answers.planners.astar.prepare(landmarks, [as_cell(goal, "goal") for goal in goals])

    @checked(InvalidQueryError)
    @one_at_a_time
    def nearest(
        self,
        start: Cell,
        goals: Sequence[Cell],
        *,
        count: int = 1,
        **options: Unpack[PlanOptions],
    ) -> list[tuple[int, Plan]]:
        """Paths to the goals that cost least to reach, cheapest first.

        Parameters
        ----------
        start : (row, col)
            A cell.
        goals : sequence of (row, col)
            At least one.
        count : int
            How many are wanted.
        **options : PlanOptions
            As for `plan`; the time is each goal's own. Only exact methods are certain to know the order of goals that
            are nearly as near.

        Returns
        -------
        list of (int, Plan)
            Numbers of the goals and the plans that lead there; last those that cannot be reached, if fewer than
            `count` can. Goals that cannot be among the nearest, by the octile distance, are not planned to.

        Raises
        ------
        InvalidQueryError
            There is no goal, or as `plan`.
        """
        return self._answers.nearest(start, goals, count, options_of(**options))

    def plan(self, start: Cell, goal: Cell, **options: Unpack[PlanOptions]) -> Plan:
        """A path from start to goal.

        Parameters
        ----------
        start, goal : (row, col)
            Cells.
        **options : PlanOptions
            By which method, how good, until when, and whether freed from the grid.

        Returns
        -------
        Plan
            Where a region fails it is widened, then the whole map is searched: NO_PATH means that there is
            none.

        Raises
        ------
        InvalidQueryError
            Start or goal are not two integers, or there is no such method.
        ModelError
            ``nnpp`` was asked for and the model cannot be loaded.
        """
        work = Work()  # the looks at the arguments count
        return self._plan_in_turn(start, goal, options_of(**options), work)

    @one_at_a_time
    def _plan_in_turn(self, start: Cell, goal: Cell, wishes: Wishes, work: Work) -> Plan:
        return self._answers.plan(start, goal, wishes, work)

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
    ) -> Tour:
        """A path from start to goal by way of other cells.

        Parameters
        ----------
        start, goal : (row, col)
            Cells.
        via : sequence of (row, col)
            The places between, in the order in which they are to be visited.
        best_order : bool
            Visit them in the order that costs least instead, by the plans between each two; with ``astar`` these are
            the cheapest paths. At most 12.
        **options : PlanOptions
            As for `plan`, of each leg; the time is that of the whole tour. Where it is up before the best order is
            known, the order given stays.

        Returns
        -------
        Tour
            Its plan has no path where one of the legs has none; the plan's reason names it.

        Raises
        ------
        InvalidQueryError
            A place between lies outside the map or is impassable, too many are to be ordered, or as `plan`.
        """
        return self._answers.via(start, goal, via, best_order, options_of(**options))

    @checked(InvalidQueryError)
    @one_at_a_time
    def reach(self, start: Cell, within: float = math.inf) -> Float2D:
        """What can be reached from a cell, and at what cost.

        Parameters
        ----------
        start : (row, col)
            A cell.
        within : float
            The most that a path may cost, in units of ``step_cost``: seconds, say.

        Returns
        -------
        (H, W) float32
            Cost of the cheapest path to each cell; inf where there is none, or none that costs at most `within`.

        Raises
        ------
        InvalidQueryError
            The cell is not two integers, lies outside the map or is impassable; or `within` is below 0.
        """
        return self._answers.reach(start, within)
