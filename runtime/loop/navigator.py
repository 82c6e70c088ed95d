"""One tick of the onboard loop: take the newest inputs, update the planner's map, answer by the
`Ladder`.
"""

import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from itertools import product
from typing import Unpack

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.cells import Cell, slices, widened
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.loop.ladder import Ladder, Tick, one_line
from nnpp_edge.runtime.loop.messages import (
    Counters,
    Goal,
    Input,
    InvalidMessageError,
    MapPatch,
    Origin,
    PathMessage,
    Pose,
)
from nnpp_edge.runtime.loop.patches import Patches, Waiting
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.loading import begin_loading
from nnpp_edge.runtime.options import PlannerOptions
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod

_LOG = logging.getLogger(__name__)


class Navigator:
    """Answers the ticks of the onboard loop with a planner, its map and the standing path.

    `offer` may be called from any thread, `tick` from one at a time.

    Parameters
    ----------
    ground : Ground
        The robot and its first map, which is copied; patches come through `offer`.
    method, refine, **options
        As of `DynamicPlanner`.
    tolerance : float
        The standing path is kept while it can cost at most this share more than a new plan.
    snap_radius : int
        Cells; if the robot stands in an impassable cell, its path may start at most this far away.
    approach : bool
        Whether paths lead as near to the goal as there is a way, where none leads to it: it may be
        unknown yet. It takes a search over all that can be reached, after each change of the map.
    slice_ms : float
        Milliseconds that a corridor is searched for in one tick that has a deadline; a search that
        takes longer goes on by `go_on` and in the next, and the robot follows what is clear of its
        path meanwhile.
    clock : callable
        Monotonic seconds; deadlines given to `tick` are readings of it.

    ModelError where the method needs a network that cannot be loaded; else errors as of
    `DynamicPlanner`.
    """

    @checked(InvalidQueryError)
    def __init__(
        self,
        ground: Ground,
        method: str = DynamicMethod.AUTO,
        *,
        refine: str | None = None,
        tolerance: float = 0.02,
        snap_radius: int = 3,
        approach: bool = False,
        slice_ms: float = 10.0,
        clock: Callable[[], float] = time.monotonic,
        **options: Unpack[PlannerOptions],
    ) -> None:
        at_least_0 = {"tolerance": tolerance, "snap_radius": snap_radius, "slice_ms": slice_ms}
        for name, value in at_least_0.items():
            if not value >= 0:
                raise InvalidQueryError(f"{name} must be at least 0, got {value}")
        self._snap_radius = snap_radius
        self._approach = approach
        self._clock = clock
        self._inbox = threading.Lock()
        self._pose: Pose | None = None
        self._goal: Goal | None = None
        self._counts: Counter[str] = Counter()
        """By the names that `Counters` has for them."""
        self._degraded: Counter[str] = Counter()
        self._errors: Counter[str] = Counter()
        side = range(-snap_radius, snap_radius + 1)
        offsets = sorted(product(side, side), key=lambda offset: math.hypot(*offset))
        self._nearest_first = [each for each in offsets if math.hypot(*each) <= snap_radius]
        if "network" in DynamicMethod(method).entry.needs:
            begin_loading(options.get("model", "edge"))
        self.planner = DynamicPlanner(ground, (0, 0), method, refine=refine, **options)
        """Plans on the loop's one map. It belongs to the thread that calls `tick`."""
        self.planner.prepare()
        self._patches = Patches(self.planner.state)
        self._ladder = Ladder(
            self.planner,
            self._update_map,
            tolerance,
            1e-3 * slice_ms,
            self.count_error,
            approach=approach,
        )

    @property
    def map(self) -> MapState:
        """The map as the last tick left it; its `cost`, `elevation`, `shape` and sides may be read
        by any thread.
        """
        return self.planner.state

    @checked(InvalidMessageError)
    def offer(self, message: Input) -> None:
        """Take an input: all patches get into the map, in their order; of poses and goals the
        newest counts.
        """
        if isinstance(message, MapPatch):
            self._patches.offer(message)
        elif isinstance(message, Pose):
            self._pose = message
        else:
            self._goal = message

    def forget(self, *, pose: bool = True, goal: bool = True) -> None:
        """Forget where the robot is, and where it is to go, as before the first came; for the
        thread that calls `tick`, or while there is none.
        """
        if pose:
            self._pose = None
        if goal:
            self._goal = None

    def count_error(self, place: str) -> None:
        """Count an error that was caught; from any thread."""
        with self._inbox:
            self._errors[place] += 1

    def counters(self) -> Counters:
        """Counts so far; of what only the loop knows 0."""
        with self._inbox:
            counts = {**self._counts, **self._patches.counts}
            by_kind_and_place = {"degraded": dict(self._degraded), "errors": dict(self._errors)}
        return Counters(**counts, **by_kind_and_place)  # type: ignore[arg-type]  # whole numbers to whole numbers

    def tick(self, deadline: float = math.inf) -> PathMessage:
        """Read the inputs and answer by `deadline`, a reading of the clock. Never raises an
        `Exception`.
        """
        self._counts["ticks"] += 1
        tick = Tick(self._clock, deadline, self._counts["ticks"])
        try:
            message = self._answer(tick)
        except Exception as error:
            _LOG.exception("a tick failed")
            self.count_error("tick")
            message = tick.no_path(Status.UNKNOWN, one_line(error))
        if message.degraded:
            self._degraded[tick.failures[0].kind] += 1
        if message.ok:
            self._counts["kept" if message.origin is Origin.STANDING else "planned"] += 1
        else:
            self._counts["failed"] += message.outcome not in (Status.NO_POSE, Status.NO_GOAL)
        return message

    def go_on(self, time_limit_s: float) -> bool:
        """Use time that is left after a tick's answer for a search that goes on; False where there
        is none. By the thread that calls `tick`. Never raises an `Exception`.
        """
        try:
            return self.planner.go_on(time_limit_s)
        except Exception:
            _LOG.exception("a search that went on failed")
            self.count_error("search")
            return False

    def _answer(self, tick: Tick) -> PathMessage:
        """The ladder's answer to the newest inputs, or what is wrong with them."""
        with self._inbox:
            pose = self._pose
            goal = self._goal
        tick.map_version = self._update_map()
        if pose is None or goal is None:
            missing = Status.NO_POSE if pose is None else Status.NO_GOAL
            return tick.no_path(missing, "nothing to plan yet")
        planner = self.planner
        grid = planner.state.grid
        here = pose.cell
        target = goal.cell
        ends = {Status.GOAL_OUTSIDE_MAP: target, Status.START_OUTSIDE_MAP: here}
        for status, cell in ends.items():
            if not grid.holds(cell):
                return tick.no_path(status, f"the map has {planner.shape} cells")
        around = ((here[0] + row, here[1] + col) for row, col in self._nearest_first)
        start = next(filter(grid.is_passable, filter(grid.holds, around)), None)
        if start is None:
            radius = self._snap_radius
            unknown = self._unknown_around(here, radius)
            reason = f"no passable cell within {radius} of the robot{unknown}"
            return tick.no_path(Status.START_BLOCKED, reason)
        heading = pose.heading_deg
        passed = None
        if heading is not None:
            passed = planner.passed(pose.row - 0.5, pose.col - 0.5, heading)
        moved = passed is None and start != here
        start, heading = passed or (start, heading)
        planner.move(start, heading)
        if not (self._approach or grid.is_passable(target)):
            reason = f"the goal is impassable{self._unknown_around(target)}"
            return tick.no_path(Status.GOAL_BLOCKED, reason)
        tick.start = start
        tick.start_moved = moved
        tick.goal = target
        self._counts["starts_moved"] += moved
        asked = (target, goal.heading_deg)
        if asked != (planner.goal, planner.goal_heading_deg):
            planner.set_goal(*asked)
        return self._ladder.answer(tick)

    def _update_map(self) -> int:
        """Put all waiting patches into the map; the number of patches that it has. If one fails
        twice, they keep waiting, and its error is raised.
        """
        with self._patches.taking() as waiting:
            for one in waiting:
                try:
                    self._put(one)
                except Exception:
                    _LOG.exception("a map update failed; the planner begins anew and tries again")
                    self.count_error("map")
                    self._put(one)
        return self._patches.taken

    def _put(self, patch: Waiting) -> None:
        put = self.planner.update_elevation if patch.of_heights else self.planner.update
        self._counts["cells_changed"] += put(*patch.part[:2], patch.values, seen=patch.seen)

    def _unknown_around(self, cell: Cell, radius: int = 0) -> str:
        """How many of the cells around one are unknown, with the vehicle's reach, for people; empty
        for none.
        """
        radius += self.map.reach_cells
        around = widened((*cell, 1, 1), (radius, radius), self.map.shape)
        unknown = self.map.unknown(*slices(around))
        if not unknown.any():
            return ""
        return f"; {unknown.sum()} of {unknown.size} cells around it are unknown"
