"""One tick of the onboard loop, top to bottom: the newest inputs are put into the planner's map and
asked about, and a ladder of ways is climbed, of which the first that gives an answer counts.

1. The standing path, if it is valid and cannot have become worse than the loop's tolerance. 2. The
method asked for, unless by its last times it would be late. 3. The corridor planner. 4. The
standing path, if it is valid at all. 5. The standing path, joined to where the robot is and to the
goal that has moved. 6. A part of the standing path, up to the place from which a search goes on.
7. An outcome that says what failed.

Corridors, and thus ``auto``, are searched for in slices: a search that has not ended after its
slice goes on once the answer is out, and in the next tick. So no tick is late by them, however
large the map.

Every path is checked cell by cell before it is published, on a map that has all patches that came
before the check.
"""

import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Unpack

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.cells import Cell, widened
from nnpp_edge.runtime.errors import InvalidQueryError, Status, one_line
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
from nnpp_edge.runtime.loop.tick import Tick
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.network.loading import begin_loading
from nnpp_edge.runtime.options import PlannerOptions
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod, Plan
from nnpp_edge.runtime.planners.standing_path import Standing

_LOG = logging.getLogger(__name__)
_LEAST_PLANNING_S = 0.002
"""A search gets at least this much time: else a loop that is always late would never plan."""
_SHARE_WITH_PATH = 0.5
"""Of a slice, where there is a path to follow: the search goes on once the answer is out."""
_FORGET = 0.9
"""Factor of a method's expected time each time that the method is skipped as too slow: so it is
tried again.
"""


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
        self._tolerance = tolerance
        self._slice_s = 1e-3 * slice_ms
        self._expected_s = 0.0
        """Time that the method asked for is expected to take, if it does not work in slices."""
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
        self.map = self.planner.state
        """As the last tick left it; its `cost`, `elevation`, `shape` and sides may be read by any
        thread.
        """
        self._patches = Patches(self.map)

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

    def forget(self, *, goal: bool = True) -> None:
        """Forget where the robot is, and where it is to go, as before the first came; for the
        thread that calls `tick`, or while there is none.
        """
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
            return Counters(
                **self._counts,  # type: ignore[arg-type]  # whole numbers to whole numbers
                **self._patches.counts,  # type: ignore[arg-type]  # likewise
                degraded=dict(self._degraded),
                errors=dict(self._errors),
            )

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
        pose = self._pose
        goal = self._goal
        tick.map_version = self._update_map()
        if pose is None or goal is None:
            missing = Status.NO_POSE if pose is None else Status.NO_GOAL
            return tick.no_path(missing, "nothing to plan yet")
        planner = self.planner
        grid = self.map.grid
        here = pose.cell
        target = goal.cell
        ends = {Status.GOAL_OUTSIDE_MAP: target, Status.START_OUTSIDE_MAP: here}
        for status, cell in ends.items():
            if not grid.holds(cell):
                return tick.no_path(status, f"the map has {grid.shape} cells")
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
        return self._climbed(tick)

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
        row, col, _, _ = patch.part
        self._counts["cells_changed"] += self.planner.update(
            row, col, patch.values, seen=patch.seen, layer=patch.layer
        )

    def _unknown_around(self, cell: Cell, radius: int = 0) -> str:
        """How many of the cells around one are unknown, with the vehicle's reach, for people; empty
        for none.
        """
        radius += self.map.reach_cells
        around = widened((*cell, 1, 1), (radius, radius), self.map.shape)
        unknown = self.map.unknown(around)
        if not unknown.any():
            return ""
        return f"; {unknown.sum()} of {unknown.size} cells around it are unknown"

    # --- the ladder

    def _climbed(self, tick: Tick) -> PathMessage:
        """The answer of the first rung that gives one; `tick` holds afterwards what failed on the
        way.
        """
        planner = self.planner
        standing = planner.standing()
        is_good = standing.valid and standing.added <= self._tolerance * abs(standing.cost)
        if is_good and not planner.search_due:
            kept = self._kept(tick, standing, "it still holds")
            if kept is not None:
                return kept
        return (
            self._planned_in_full(tick)
            or self._planned_by_corridor(tick, standing)
            or self._kept(tick, standing, tick.failures[0].reason)
            or self._led(tick, planner.joined, "a short way leads along the path planned before")
            or self._led(tick, planner.clear_part, "the standing path is clear as far as this")
            or self._all_failed(tick)
        )

    # --- the rungs: an answer, or None, with what failed noted in the tick

    def _planned_in_full(self, tick: Tick) -> PathMessage | None:
        planner = self.planner
        if not planner.method.entry.in_slices:
            if planner.searching:
                tick.fail("timeout", "the search of a corridor goes on")
                return None
            if self._expected_s > max(tick.left_s, _LEAST_PLANNING_S):
                self._expected_s *= _FORGET
                tick.fail("late", "by its last times the full method would be late")
                return None
        return self._planned(tick, Origin.FULL)

    def _planned_by_corridor(self, tick: Tick, standing: Standing) -> PathMessage | None:
        in_slices = self.planner.method.entry.in_slices
        if in_slices and tick.failures[-1].kind == "timeout":
            return None  # it has just had its slice
        if standing.valid and tick.left_s <= 0.0:
            return None  # the standing path takes no time
        return self._planned(tick, Origin.CORRIDOR, DynamicMethod.CORRIDOR)

    def _kept(self, tick: Tick, standing: Standing, reason: str) -> PathMessage | None:
        """The standing path, if it is valid."""
        plan = self.planner.standing_plan
        if plan is None or not standing.valid:
            return None
        rest = plan.rest(standing.index)
        rest = replace(rest, cost=standing.cost, lower_bound=standing.lower_bound)
        return self._path(tick, rest, Origin.STANDING, reason)

    def _led(self, tick: Tick, path: Callable[[], Plan | None], why: str) -> PathMessage | None:
        """What else is left of the standing path while a search goes on."""
        failure = tick.failures[-1]
        plan = path() if failure.kind == "timeout" else None
        reason = f"{failure.reason}; {why}"
        return None if plan is None else self._path(tick, plan, Origin.STANDING, reason)

    def _all_failed(self, tick: Tick) -> PathMessage:
        late = any(failure.kind in ("late", "timeout") for failure in tick.failures)
        outcome = Status.TIMEOUT if late else Status.UNKNOWN
        return tick.no_path(outcome, tick.failures[-1].reason, degraded=True)

    # --- their parts

    def _planned(
        self, tick: Tick, origin: Origin, method: DynamicMethod | None = None
    ) -> PathMessage | None:
        """The answer by a new plan, by default by the method asked for."""
        began = tick.clock()
        in_slices = (method or self.planner.method).entry.in_slices
        left_s = tick.left_s
        if in_slices and left_s < math.inf:
            # what there is to follow is the answer until the search has ended
            share = _SHARE_WITH_PATH if self.planner.has_path else 1.0
            left_s = min(left_s, share * self._slice_s)
        try:
            plan = self.planner.replan(
                method=method,
                time_limit_s=max(left_s, _LEAST_PLANNING_S),
                goes_on=in_slices,
                approach=self._approach,
            )
        except Exception as error:
            _LOG.warning("planning of %s raised", origin, exc_info=True)
            self.count_error(str(origin))
            tick.fail("raised", one_line(error))
            return None
        if method is None:
            took_s = tick.clock() - began
            mean = 0.8 * self._expected_s + 0.2 * took_s
            self._expected_s = max(took_s, mean if plan.ok else self._expected_s)
        if plan.status is Status.TIMEOUT:
            tick.fail("timeout", plan.reason if in_slices else "the search ran out of time")
            return None
        if not plan.ok:
            return tick.no_path(plan.status, plan.reason)
        reason = tick.failures[-1].reason if tick.failures else plan.reason
        message = self._path(tick, plan, origin, reason)
        if message is None:
            tick.fail("map_changed", "the map changed while planning")
        return message

    def _path(self, tick: Tick, plan: Plan, origin: Origin, reason: str) -> PathMessage | None:
        """The plan's path as a message; None if it does not hold on the newest map."""
        if origin is Origin.STANDING:
            plan = self.planner.refined(plan)
        path = plan.path
        version = self._update_map()
        is_newer = version != tick.map_version
        blocked = -1
        if is_newer:  # on the map as it was a path is walked where it is planned, joined and kept
            blocked = self.planner.first_blocked(plan.walked)
            plan = replace(plan, waypoints=None, line_cost=math.inf)  # which are not checked on it
            standing = self.planner.standing()
            if standing.valid:
                plan = replace(plan, cost=standing.cost, lower_bound=standing.lower_bound)
        if blocked >= 0 or tuple(path[0].tolist()) != tick.start:
            words = "a path from %s is not published: it begins elsewhere, or is blocked at cell %d"
            _LOG.info(words, origin, blocked)
            return None
        known = None
        if self.map.unseen is not None:
            as_planned = origin is not Origin.STANDING and not is_newer
            known = plan.known if as_planned else self.map.known_along(path)
        return tick.path(plan, origin, reason, version, known)
