"""Inputs and outputs of the onboard loop."""

import math
from dataclasses import asdict, dataclass, field
from enum import StrEnum

import numpy as np

from nnpp_edge.runtime.arrays import Cells, Float2D, Floats, as_map, headings_along
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidMapError, NnppEdgeError, Status, shown
from nnpp_edge.runtime.robots.body.arcs import Arc

_WANTED = {
    int: "a whole number",
    float: "a finite number",
    float | None: "a finite number",
    bool: "True or False",
}
"""What attributes of messages are, by their types."""


class InvalidMessageError(NnppEdgeError, ValueError):
    """A message with invalid values."""


class Origin(StrEnum):
    """Rung of the navigator's ladder that gave a path."""

    FULL = "full"
    """Planned in this tick by the method that was asked for."""
    CORRIDOR = "corridor"
    """Planned in this tick by the corridor planner, as the full method failed or would have been
    late.
    """
    STANDING = "standing"
    """The path of an earlier tick, checked against the newest map."""
    NONE = "none"
    """There is no path."""


class _Checked:
    """A message of numbers and truth values, which are looked at when it is made."""

    def __post_init__(self) -> None:
        """InvalidMessageError unless its numbers and truth values are such; whole numbers become
        ints.
        """
        for name, kind in type(self).__annotations__.items():
            value = getattr(self, name)
            if kind not in _WANTED or (value is None and kind == float | None):
                continue
            number = int if kind is int else float
            try:
                fits = bool(number(value) == value) and math.isfinite(value)
            except (TypeError, ValueError, OverflowError):
                fits = False
            if kind is bool:
                fits = isinstance(value, bool | np.bool_)
            if not fits:
                owner = type(self).__name__.removeprefix("Map").lower()
                wanted = f"a {owner}'s {name} must be {_WANTED[kind]}"
                raise InvalidMessageError(f"{wanted}, got {shown(value)}")
            if kind is int:
                object.__setattr__(self, name, int(value))


@dataclass(frozen=True, eq=False)
class MapPatch(_Checked):
    """New heights, or new costs, of a rectangle of the map. The array is copied.

    InvalidMessageError unless exactly one of the two arrays is given, (h, w) numbers, no cost below
    0, and origin and stamp are numbers.
    """

    row: int
    """Of the patch's first cell; the patch may stick out of the map."""
    col: int
    elevation: Float2D | None = None
    """(h, w) metres; NaN or infinite where the cell was not seen."""
    cost: Float2D | None = None
    """(h, w) traversability cost or weight, as the planner takes it; NaN where the cell was not
    seen.
    """
    keep_known: bool = False
    """Whether cells that were not seen stay as the map has them; else they become impassable."""
    stamp: float = 0.0
    """When it was measured, by the sender's clock. It is passed on to logs and changes nothing."""

    def __post_init__(self) -> None:
        if (self.elevation is None) == (self.cost is None):
            raise InvalidMessageError(
                "a patch must hold either elevation or cost, got both or neither"
            )
        name = "cost" if self.elevation is None else "elevation"
        try:
            values = np.array(as_map(getattr(self, name), f"a patch's {name}"))
        except InvalidMapError as error:
            raise InvalidMessageError(str(error)) from None
        if name == "cost" and (values < 0.0).any():
            raise InvalidMessageError(
                f"a patch's cost must be at least 0, got one of {np.nanmin(values):g}"
            )
        object.__setattr__(self, name, values)
        super().__post_init__()

    @property
    def values(self) -> Float2D:
        """(h, w) heights or costs, whichever it has."""
        values = self.cost if self.elevation is None else self.elevation
        assert values is not None
        return values

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.values.shape[0], self.values.shape[1]


@dataclass(frozen=True)
class Pose(_Checked):
    """Where the robot is, in cells; fractions lie within a cell. InvalidMessageError unless all is
    finite.
    """

    row: float
    col: float
    stamp: float = 0.0
    heading_deg: float | None = None
    """In which a body stands, clockwise from grid north; None: a path begins in any direction."""

    @property
    def cell(self) -> Cell:
        """The cell it lies in."""
        return math.floor(self.row), math.floor(self.col)


@dataclass(frozen=True)
class Goal(_Checked):
    """Where to go, in cells. InvalidMessageError unless both are whole numbers, and the rest is
    finite.
    """

    row: int
    col: int
    stamp: float = 0.0
    heading_deg: float | None = None
    """In which a body is to arrive, clockwise from up the rows; None: in any. A point has none."""

    @property
    def cell(self) -> Cell:
        """As (row, col)."""
        return self.row, self.col


Input = MapPatch | Pose | Goal


@dataclass(frozen=True, eq=False)
class PathMessage:
    """The answer of a tick. The path is empty exactly where the outcome is not OK, or else
    InvalidMessageError.
    """

    tick: int
    outcome: Status
    origin: Origin
    path: Cells = field(default_factory=lambda: np.empty((0, 2), np.int32))
    """(N, 2) cells (row, col) from the robot to the goal, passable on the newest map that the loop
    had.
    """
    start: Cell | None = None
    """Where the path starts."""
    goal: Cell | None = None
    start_moved: bool = False
    """The robot stands in an impassable cell, and the path starts at the nearest passable one."""
    degraded: bool = False
    """The answer is less than was asked for; `reason` says why."""
    cost: float = math.inf
    lower_bound: float = 0.0
    """No path costs less."""
    method: str = ""
    """Method that planned the path."""
    reason: str = ""
    """Why the path was kept, or what failed; for people."""
    map_version: int = 0
    """Number of map patches that the answer takes into account."""
    planning_ms: float = 0.0
    """From the beginning of the tick to this answer."""
    waypoints: Floats | None = None
    """(N, 2) places (row, col) in cells, as in `Plan`; None unless asked for, or where the map
    changed meanwhile.
    """
    line_cost: float = math.inf
    """As in `Plan`."""
    goal_moved: bool = False
    """The path leads to `goal` alone: as near to the goal that was asked for as there is a way, or
    while a search goes on, as far as the standing path is clear; `reason` says so then.
    """
    choice: str = ""
    """Why that method was picked, where there was a choice; for people."""
    states: tuple[int, ...] = ()
    arcs: tuple[Arc, ...] = ()
    """Of a body that drives arcs, as in `Plan`; empty of others."""
    headings: tuple[float, ...] = ()
    """Degrees in which it stands on each cell."""
    known: int | None = None
    """Cells of the path, from its first on, that are known; None where the map is known finely."""

    def __post_init__(self) -> None:
        cells = len(self.path)
        if self.ok != bool(cells):
            raise InvalidMessageError(
                f"only an outcome of OK comes with a path, got {self.outcome} with {cells} cells"
            )

    @property
    def ok(self) -> bool:
        """Whether there is a path to follow."""
        return self.outcome is Status.OK

    @property
    def headings_deg(self) -> Floats:
        """(N,) degrees clockwise from grid north, of each cell of the path as in `Plan`; none for
        a path of one.
        """
        return np.array(self.headings) if self.headings else headings_along(self.path)

    @property
    def walked(self) -> Cells:
        """As in `Plan`."""
        if not self.states:
            return self.path
        return np.column_stack((self.path, self.states)).astype(np.int32)

    def summary(self) -> dict[str, object]:
        """Ready for JSON: an infinite cost is None, and way points are left out where there are
        none.
        """
        fields: dict[str, object] = vars(self) | {
            "path": self.path.tolist(),
            "headings_deg": self.headings_deg.tolist(),
            "cost": self.cost if math.isfinite(self.cost) else None,
        }
        if not self.states:
            del fields["states"], fields["arcs"], fields["headings"]
        if self.known is None:
            del fields["known"]
        if self.waypoints is None:
            del fields["waypoints"], fields["line_cost"]
            return fields
        return fields | {"waypoints": self.waypoints.tolist()}


CountBy = dict[str, int]
"""Counts by kind, place or sink."""


@dataclass(frozen=True)
class Counters:
    """Counts of a loop since it started."""

    ticks: int = 0
    planned: int = 0
    """Ticks that planned a new path."""
    kept: int = 0
    """Ticks that kept the standing path."""
    failed: int = 0
    """Ticks with pose and goal, but without a path."""
    overruns: int = 0
    """Ticks that took longer than the period."""
    skipped: int = 0
    """Deadlines that passed unused."""
    degraded: CountBy = field(default_factory=dict)
    """Degraded answers by kind."""
    errors: CountBy = field(default_factory=dict)
    """Errors that were caught, by place."""
    patches: int = 0
    """Map patches that came."""
    cells_changed: int = 0
    """Cells that patches changed."""
    patches_clipped: int = 0
    """Map patches that stuck out of the map."""
    patches_rejected: int = 0
    """Map patches that were refused."""
    patches_merged: int = 0
    """Changes of the map that were merged with the next, as too many were waiting. No changed cell
    is lost.
    """
    starts_moved: int = 0
    """Ticks whose path starts beside the robot, which stood in an impassable cell."""
    drops: CountBy = field(default_factory=dict)
    """Messages that a sink was too slow for, by sink."""
    lost: CountBy = field(default_factory=dict)
    """Messages that a sink took and could not keep, by sink, of sinks that count them."""
    tick_ms: dict[str, float] = field(default_factory=dict)
    """Work of a tick: ``p50``, ``p90``, ``p99``, ``max``, ``mean``."""
    rss_bytes: int = 0
    """Memory of the process; 0 where the system does not say."""


@dataclass(frozen=True)
class StatusMessage:
    """State of the loop; sent about every second."""

    tick: int
    outcome: Status
    """Of the last tick."""
    text: str
    counters: Counters

    def summary(self) -> dict[str, object]:
        """Ready for JSON."""
        return asdict(self)


Output = PathMessage | StatusMessage
