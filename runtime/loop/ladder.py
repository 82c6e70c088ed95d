"""How a tick of the onboard loop comes to its path: a ladder of ways, of which the first that gives
an answer counts.

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
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.messages import Origin, PathMessage
from nnpp_edge.runtime.loop.workers import CountError
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


class Failure(NamedTuple):
    """Why a rung of the ladder gave no answer."""

    kind: str
    """As in `Counters.degraded`."""
    reason: str


@dataclass
class Tick:
    """A tick's question, and what has failed so far."""

    clock: Callable[[], float]
    """Monotonic seconds."""
    deadline: float
    """Reading of the clock."""
    known: PathMessage
    """The answer as far as it is known: number, map, start and goal."""
    standing: Standing | None = None
    """The standing path, while it is valid."""
    failures: list[Failure] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._started = self.clock()

    def fail(self, kind: str, reason: str) -> None:
        """Note that a rung has failed."""
        self.failures.append(Failure(kind, reason))

    @property
    def left_s(self) -> float:
        """To the deadline; below 0 once it has passed."""
        return self.deadline - self.clock()

    def no_path(self, outcome: Status, reason: str, *, degraded: bool = False) -> PathMessage:
        """The answer without a path."""
        ms = 1e3 * (self.clock() - self._started)
        return replace(
            self.known, outcome=outcome, reason=reason, degraded=degraded, planning_ms=ms
        )


class Ladder:
    """Answers a tick whose start and goal are known and passable. Serves one thread at a time.

    Every path is checked after `update_map` has put all patches that wait into the planner's map,
    and said how many the map has. The standing path is kept while it can cost at most `tolerance`,
    a share, more than a new plan. A search in slices works `slice_s` seconds in each tick that has
    a deadline. `count_error` is called with ``full`` or ``corridor`` when planning raised. With
    `approach` paths lead as near to the goal as there is a way.
    """

    def __init__(
        self,
        planner: DynamicPlanner,
        update_map: Callable[[], int],
        tolerance: float,
        slice_s: float,
        count_error: CountError,
        *,
        approach: bool,
    ) -> None:
        self._planner = planner
        self._approach = approach
        self._update_map = update_map
        self._tolerance = tolerance
        self._count_error = count_error
        self._slice_s = slice_s
        self._in_slices = planner.method.entry.in_slices
        """Whether the method asked for works so."""
        self._expected_s = 0.0
        """Time that it is expected to take, if not."""

    def answer(self, tick: Tick) -> PathMessage:
        """The answer of the first rung that gives one; `tick` holds afterwards what failed on the
        way.
        """
        standing = self._planner.standing()
        tick.standing = standing if standing.valid else None
        return (
            self._standing_while_good(tick)
            or self._planned_in_full(tick)
            or self._planned_by_corridor(tick)
            or self._standing_path(tick, tick.failures[0].reason)
            or self._joined(tick)
            or self._as_far_as_clear(tick)
            or self._all_failed(tick)
        )

    # --- the rungs: an answer, or None, with what failed noted in the tick

    def _standing_while_good(self, tick: Tick) -> PathMessage | None:
        standing = tick.standing
        if standing is None or standing.added > self._tolerance * abs(standing.cost):
            return None
        if self._planner.search_due:
            return None
        message = self._standing_path(tick, "it still holds")
        if message is None:
            tick.standing = None
        return message

    def _planned_in_full(self, tick: Tick) -> PathMessage | None:
        if self._in_slices:
            return self._planned(tick, Origin.FULL)
        if self._planner.searching:
            tick.fail("timeout", "the search of a corridor goes on")
            return None
        if self._expected_s > max(tick.left_s, _LEAST_PLANNING_S):
            self._expected_s *= _FORGET
            tick.fail("late", "by its last times the full method would be late")
            return None
        return self._planned(tick, Origin.FULL)

    def _planned_by_corridor(self, tick: Tick) -> PathMessage | None:
        if self._in_slices and tick.failures[-1].kind == "timeout":
            return None  # it has just had its slice
        if tick.standing is not None and tick.left_s <= 0.0:
            return None  # the standing path takes no time
        return self._planned(tick, Origin.CORRIDOR, DynamicMethod.CORRIDOR)

    def _standing_path(self, tick: Tick, reason: str) -> PathMessage | None:
        standing = tick.standing
        plan = self._planner.standing_plan
        if standing is None or plan is None:
            return None
        rest = plan.rest(standing.index)
        left = replace(rest, cost=standing.cost, lower_bound=standing.lower_bound)
        freed = self._planner.refined(left)
        return self._path(tick, freed, Origin.STANDING, reason) if freed.ok else None

    def _joined(self, tick: Tick) -> PathMessage | None:
        if tick.failures[-1].kind != "timeout":
            return None
        plan = self._planner.joined()
        if plan is None:
            return None
        reason = f"{tick.failures[-1].reason}; a short way leads along the path planned before"
        return self._path(tick, self._planner.refined(plan), Origin.STANDING, reason)

    def _as_far_as_clear(self, tick: Tick) -> PathMessage | None:
        part = self._planner.clear_part()
        if part is None:
            return None
        freed = self._planner.refined(part)
        reason = f"{tick.failures[-1].reason}; the standing path is clear as far as this"
        return self._path(tick, freed, Origin.STANDING, reason) if freed.ok else None

    def _all_failed(self, tick: Tick) -> PathMessage:
        late = any(failure.kind in ("late", "timeout") for failure in tick.failures)
        reason = tick.failures[-1].reason
        return tick.no_path(Status.TIMEOUT if late else Status.UNKNOWN, reason, degraded=True)

    # --- their parts

    def _planned(
        self, tick: Tick, origin: Origin, method: DynamicMethod | None = None
    ) -> PathMessage | None:
        """The answer by a new plan, by default by the method asked for."""
        began = tick.clock()
        in_slices = self._in_slices or (method is not None and method.entry.in_slices)
        left_s = tick.left_s
        if in_slices and left_s < math.inf:
            slice_s = self._slice_s
            if self._planner.has_path:  # which is the answer until the search has ended
                slice_s *= _SHARE_WITH_PATH
            left_s = min(left_s, slice_s)
        try:
            plan = self._planner.replan(
                method=method,
                time_limit_s=max(left_s, _LEAST_PLANNING_S),
                goes_on=in_slices,
                approach=self._approach,
            )
        except Exception as error:
            _LOG.warning("planning by %s raised", method or self._planner.method, exc_info=True)
            self._count_error(str(origin))
            tick.fail("raised", one_line(error))
            return None
        took_s = tick.clock() - began
        if method is None:
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
        path = plan.path
        version = self._update_map()
        if tuple(path[0].tolist()) != tick.known.start:
            _LOG.info("a path from %s is not published: it begins elsewhere", origin)
            return None
        blocked = self._planner.first_blocked(plan.walked)
        if blocked >= 0:
            words = "a path from %s is not published: it cannot be walked at %s"
            _LOG.info(words, origin, path[blocked].tolist())
            return None
        state = self._planner.state
        known = None
        priced: Plan | Standing = plan
        if version != tick.known.map_version:
            # the map has changed since: way points are not checked on it
            plan = replace(plan, waypoints=None, line_cost=math.inf)
            standing = self._planner.standing()
            priced = standing if standing.valid else plan
        if state.unseen is not None:
            anew = origin is Origin.STANDING or version != tick.known.map_version
            known = state.known_along(path) if anew else plan.known
        row, col = path[-1].tolist()
        return replace(
            tick.no_path(Status.NO_PATH, reason, degraded=bool(tick.failures)),
            outcome=Status.OK,
            goal=(row, col),
            goal_moved=(row, col) != tick.known.goal,
            origin=origin,
            path=path,
            map_version=version,
            method=plan.planner,
            choice=plan.choice,
            states=() if plan.states is None else tuple(plan.states.tolist()),
            headings=() if plan.states is None else tuple(plan.headings_deg.tolist()),
            arcs=plan.arcs,
            known=known,
            waypoints=plan.waypoints,
            line_cost=plan.line_cost,
            cost=priced.cost,
            lower_bound=priced.lower_bound,
        )


def one_line(error: BaseException) -> str:
    """An error's type and message in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
