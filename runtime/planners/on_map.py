"""The common part of planners of a standing and of a changing map: the map, its patches, and one
thread's turn.
"""

import functools
import math
from collections.abc import Callable, Mapping
from threading import RLock
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar, Unpack

import numpy as np

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Bool, Float2D
from nnpp_edge.runtime.cells import Cell, as_cell
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import (
    ConcurrentUseError,
    InvalidMapError,
    InvalidQueryError,
    NnppEdgeError,
    shown,
)
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import MapState, map_state
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.options import PlannerOptions
from nnpp_edge.runtime.planners.methods import Methods, file_of
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.planners.query import in_words, problem_with
from nnpp_edge.runtime.robots.robot import CellMoves
from nnpp_edge.runtime.search.astar import cost_field
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import NEAR

if TYPE_CHECKING:
    from nnpp_edge.runtime.robots.body.attitude import PoseCheck
    from nnpp_edge.runtime.terrain.traversability import Traversability

P = ParamSpec("P")
R = TypeVar("R")


S = TypeVar("S", bound="OnMap")


def one_at_a_time(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """A planner's method that is refused while a call of another thread is at work.

    A call that ends with an error of ours has changed nothing or finished what it changed. Any
    other exception, such as a KeyboardInterrupt, may have come between two steps that belong
    together: the next call begins anew first. Such methods must not call one another.
    """

    @functools.wraps(method)
    def guarded(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        if not self._turn.acquire(blocking=False):
            raise ConcurrentUseError(
                "wanted one call at a time, got one while another thread's is at work: give each "
                "thread a planner of "
                "its own (and make a planner anew whose call was broken off in another thread)"
            )
        try:
            if self._half_done:
                self._begin_anew()
            self._half_done = True
            try:
                result = method(self, *args, **kwargs)
            except NnppEdgeError:
                self._half_done = False
                raise
            self._half_done = False
            return result
        finally:
            self._turn.release()

    return guarded


class OnMap:
    """A planner's map. Serves one thread at a time: another thread's call meanwhile is a
    ConcurrentUseError.

    After a call that was broken off, by a KeyboardInterrupt for one, the planner makes anew all but
    the map itself (landmarks are gone); an update that was broken off is in the map whole or not at
    all.
    """

    _repeated = False
    """Whether queries lead to one goal, again and again, and it is kept which cells are unknown."""

    def __init__(
        self,
        cost: Float2D | Ground,
        *,
        cell_size_m: float | None = None,
        **options: Unpack[PlannerOptions],
    ) -> None:
        own, rest = split(options)
        if isinstance(cost, Ground) and (own or cell_size_m is not None):
            raise InvalidQueryError(
                f"with a Ground wanted its own {', '.join(own) or 'cell_size_m'}, got another"
            )
        ground = cost if isinstance(cost, Ground) else Ground(cost, cell_size_m=cell_size_m, **own)
        self._turn = RLock()
        self._half_done = False
        self._model = rest.pop("model", "edge")
        self._ask_from = rest.pop("ask_from", NEAR)
        self._state: MapState = map_state(ground, tell_unknown=self._repeated, **rest)
        self._make()

    def _make(self) -> None:
        """Make from the map all that is kept beside it."""
        self._methods = Methods(self._state, self._model, self._ask_from, repeated=self._repeated)

    def _begin_anew(self) -> None:
        self._state.begin_anew()
        self._make()

    def __getstate__(self) -> dict[str, object]:
        """The map and the model: copies, pickled or not, are to be prepared anew."""
        return {name: getattr(self, name) for name in ("_state", "_model", "_ask_from")}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state, _turn=RLock(), _half_done=False)
        self._make()

    @property
    def state(self) -> MapState:
        """The map, its coarse levels and the log of its changes; to be changed by
        `update` alone.
        """
        return self._state

    @property
    def _moves(self) -> CellMoves:
        return self._state.grid.robot.moves

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self._state.shape

    def is_passable(self, cell: Cell) -> bool:
        """Whether a cell of the map can be stood on."""
        return self._state.grid.is_passable(as_cell(cell, "cell"))

    @checked(InvalidQueryError)
    @one_at_a_time
    def explain(self, cell: Cell, heading_deg: float) -> "PoseCheck":
        """How the vehicle stands on a cell with a heading, degrees clockwise from grid north: each
        limit.

        The body is checked on this very cell with this very heading. The steps of a path are
        checked with all places and headings between, so one may be refused where this is not.
        InvalidQueryError without a body on a map of elevations, for what is no cell of the map, or
        a heading that is no number.
        """
        return self._moves.explain(as_cell(cell, "cell"), heading_deg)

    @checked(InvalidQueryError)
    @one_at_a_time
    def update(
        self,
        row: int,
        col: int,
        patch: Float2D,
        *,
        seen: Bool | None = None,
        layer: str = "cost",
    ) -> int:
        """Put new costs into the map.

        On a map of elevations these costs are a layer of their own: a cell costs the greater of
        that and of what its heights make of it, and is impassable where either says so. For a body,
        and where steps cost by the slope, only cells that they make impassable count.

        Parameters
        ----------
        row, col : int
            Where the patch's first cell goes.
        patch : (h, w) float
            New costs. NaN is impassable on a map of costs, and tells a map of elevations nothing.
        seen : (h, w) bool
            The cells that get new costs; by default all.
        layer : str
            Of another layer than costs, by its name, the numbers are new.

        Returns
        -------
        int
            Number of changed cells.

        Raises
        ------
        InvalidMapError, InvalidQueryError
            The patch does not lie inside the map, or holds a cost out of range; then the map is as
            it was.
        """
        change = self._state.update(row, col, patch, _mask(seen, patch), layer)
        self._changed()
        return change.cells

    @checked(InvalidQueryError)
    @one_at_a_time
    def update_elevation(
        self, row: int, col: int, patch: Float2D, *, seen: Bool | None = None
    ) -> int:
        """Put new elevations, metres and NaN where unknown, into a map of such; otherwise as
        `update`.

        Cells whose cost has not been computed yet count as changed. InvalidMapError for a map of
        costs.
        """
        change = self._state.update(row, col, patch, _mask(seen, patch), "heights")
        self._changed()
        return change.cells

    def _changed(self) -> None:
        """The map has just changed."""

    @one_at_a_time
    def touch(self) -> None:
        """Have the system back the planner's arrays with memory now, rather than when they are
        first written to.
        """
        if self._state.unseen is None:
            touch(self._methods.astar.workspace)
            self._methods.descent.touch()

    def _frees(self, refine: str | None) -> bool:
        """Whether paths are freed from the grid, by the option of that name."""
        if refine is None:
            return False
        from nnpp_edge.runtime.planners.refine import refines

        return refines(refine, self._state.grid)

    def _freed(self, plan: Plan, deadline: Deadline = NEVER) -> Plan:
        """The plan, freed from the grid."""
        from nnpp_edge.runtime.planners.refine import refined

        return refined(plan, self._state, deadline)

    @checked(InvalidQueryError)
    @one_at_a_time
    def reach(self, start: Cell, within: float = math.inf) -> Float2D:
        """Costs of reaching every cell from one: (H, W) float32, of the cheapest path to each.

        inf where there is none, or none that costs at most `within`, in units of ``step_cost``:
        seconds, say. InvalidQueryError where the start is no cell, outside the map or impassable,
        or `within` is below 0.
        """
        if not within >= 0.0:
            raise InvalidQueryError(f"within must be a number of at least 0, got {within}")
        cell = as_cell(start, "start")
        grid = self._state.grid
        if problem := problem_with(grid, cell, cell):
            raise InvalidQueryError(f"start {cell} {in_words(problem)}")
        # of its own: another search may be paused meanwhile
        memory = Workspace(len(grid.weights), self._moves.states_a_node, sparse=True)
        field = cost_field(grid, cell, memory)
        field[field > within] = np.inf
        return field


def split(options: Mapping[str, object]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The options that are attributes of `Ground`, and the others."""
    own = {name: value for name, value in options.items() if name in Ground.__annotations__}
    rest = {name: value for name, value in options.items() if name not in own}
    return own, rest


def coarse_ground(
    dem: Float2D,
    cell_size_m: float,
    factor: int,
    traversability: "Traversability | None",
    options: PlannerOptions,
) -> tuple[Ground, dict[str, Any]]:
    """The ground of `Planner.of_coarse`, and the options that are left for the planner."""
    own, rest = split(options)
    model = file_of(rest.pop("model", "unseen"))
    ground = Ground.of_coarse(dem, cell_size_m, factor, traversability, model=model, **own)
    return ground, rest


def _mask(seen: Bool | None, patch: Float2D) -> Bool | None:
    if seen is None:
        return None
    if not isinstance(seen, np.ndarray) or seen.dtype != np.bool_ or seen.shape != np.shape(patch):
        raise InvalidMapError(f"seen must be {np.shape(patch)} truth values, got {shown(seen)}")
    return np.ascontiguousarray(seen)
