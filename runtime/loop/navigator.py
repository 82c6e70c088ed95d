"""One tick of the onboard loop: take in what is new, check the path that stands, plan anew if need be.

An answer comes from the first rung of this ladder that holds:

1. the standing path, if it is valid on the newest map and cannot have become worse than `Settings.tolerance`;
2. the method asked for, unless by its last times it would be late;
3. the corridor planner;
4. the standing path, if it is valid at all;
5. an outcome that says what failed.

Whatever it is, a path is checked cell by cell against the newest map before it leaves.
"""

import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.loop.messages import Counters, Goal, Input, MapPatch, Origin, Outcome, PathMessage, Pose
from nnpp_edge.runtime.loop.world import World
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.dynamic import DynamicMethod, DynamicPlanner
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.planners.standing_path import Standing

_LOG = logging.getLogger(__name__)
_LEAST_PLANNING_S = 0.002
"""A search gets this much time even where none is left: else a loop that is always late would never plan."""
_FORGET = 0.9
"""What the expected time is multiplied by when a method is passed over for it, so that it is tried again."""


@dataclass(frozen=True)
class Settings:
    """How a navigator plans."""

    method: str = DynamicMethod.AUTO
    step_cost: str = "paper"
    """``length`` needs a world made for it."""
    omega: float = PAPER_OMEGA
    corner_cutting: bool = True
    model: str | Path | NetworkModel = "edge"
    tolerance: float = 0.02
    """A standing path is kept while it cannot cost more than this share above what a new plan might."""
    snap_radius: int = 3
    """Cells; so far from a robot in an impassable cell a path may start."""

    def __post_init__(self) -> None:
        """Refuse numbers out of range."""
        if not self.tolerance >= 0.0:
            raise InvalidQueryError(f"tolerance must be at least 0, got {self.tolerance}")
        if self.snap_radius < 0:
            raise InvalidQueryError(f"snap_radius must be at least 0, got {self.snap_radius}")


class Navigator:
    """The loop's mind: a world, a planner, the path that stands.

    `offer` and `reload` may be called from any thread, `tick` from one at a time.

    Parameters
    ----------
    world : World
        The map; patches for it come through `offer`.
    settings : Settings
        How to plan.
    clock : callable
        Monotonic seconds, the same as the deadlines given to `tick`.

    Raises
    ------
    ModelError
        The method asks a network, and the model cannot be loaded.
    InvalidMapError, InvalidQueryError
        As for `DynamicPlanner`.
    """

    def __init__(
        self, world: World, settings: Settings | None = None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.world, self.settings = world, settings or Settings()
        self._clock = clock
        self._inbox = threading.Lock()
        self._pose: Pose | None = None
        self._goal: Goal | None = None
        self._model: str | Path | NetworkModel = self.settings.model
        self._next_model: NetworkModel | None = None
        self._degraded: Counter[str] = Counter()
        self._errors: Counter[str] = Counter()
        self._patches = self._cells_changed = self._starts_moved = self._reloads = 0
        self._ticks = self._planned = self._kept = self._failed = 0
        self._expected_s = 0.0
        """What the method asked for is expected to take."""
        self._version = 0
        self._planner = self._new_planner()

    def offer(self, message: Input) -> None:
        """Hand an input over: patches go into the map at once, of poses and goals the newest counts."""
        if isinstance(message, MapPatch):
            self.world.put(message)
            with self._inbox:
                self._patches += 1
            return
        with self._inbox:
            if isinstance(message, Pose):
                self._pose = message
            else:
                self._goal = message

    def reload(self, model: str | Path | None = None) -> None:
        """Load a network, try it, and ask it from the next tick on; if that fails, the old one stays.

        Parameters
        ----------
        model : str or Path
            By default the file of the present one, read again.

        Raises
        ------
        ModelError
            The model cannot be used; the loop goes on with the old one.
        """
        try:
            present = self._model.path if isinstance(self._model, NetworkModel) else self._model
            loaded = NetworkModel(present if model is None else model)
            loaded.run()
        except Exception:
            self.count_error("reload")
            raise
        with self._inbox:
            self._next_model = loaded

    def count_error(self, where: str) -> None:
        """Book an error that was caught."""
        with self._inbox:
            self._errors[where] += 1

    def counters(self) -> Counters:
        """What was done so far; what only the runner knows is 0."""
        with self._inbox:
            return Counters(
                ticks=self._ticks, planned=self._planned, kept=self._kept, failed=self._failed,
                degraded=dict(self._degraded), errors=dict(self._errors), patches=self._patches,
                cells_changed=self._cells_changed, patches_clipped=self.world.clipped,
                patches_rejected=self.world.rejected, patches_merged=self.world.merged,
                starts_moved=self._starts_moved, reloads=self._reloads,
            )  # fmt: skip

    def tick(self, deadline: float = math.inf) -> PathMessage:
        """Take in what is new and answer by `deadline`, a reading of the clock. Never raises an `Exception`."""
        began = self._clock()
        self._ticks += 1
        try:
            message = self._tick(began, deadline)
        except Exception as error:
            _LOG.exception("a tick failed")
            self.count_error("tick")
            message = self._failure(began, Outcome.UNKNOWN, _told(error))
        if message.ok:
            self._kept += message.origin is Origin.STANDING
            self._planned += message.origin is not Origin.STANDING
        else:
            self._failed += message.outcome not in (Outcome.NO_POSE, Outcome.NO_GOAL)
        return message

    def _tick(self, began: float, deadline: float) -> PathMessage:
        with self._inbox:
            pose, goal, model, self._next_model = self._pose, self._goal, self._next_model, None
        if model is not None:
            self._model = model
            self._planner.use_model(model)
            self._reloads += 1
            self._expected_s = 0.0
        self._take_map()
        if pose is None or goal is None:
            return self._failure(began, Outcome.NO_POSE if pose is None else Outcome.NO_GOAL, "nothing to plan yet")
        if not self._holds(goal.cell):
            return self._failure(began, Outcome.GOAL_OUTSIDE_MAP, f"the map has {self.world.shape} cells")
        if not self._holds(pose.cell):
            return self._failure(began, Outcome.START_OUTSIDE_MAP, f"the map has {self.world.shape} cells")
        if goal.cell != self._planner.goal:
            self._planner.set_goal(goal.cell)
        start = self._nearest_passable(pose.cell)
        if start is None:
            radius = self.settings.snap_radius
            reason = f"no passable cell within {radius} of the robot"
            return self._failure(began, Outcome.START_BLOCKED, reason)
        if not self._planner.grid.is_passable(*goal.cell):
            return self._failure(began, Outcome.GOAL_BLOCKED, "the goal is impassable")
        self._starts_moved += start != pose.cell
        self._planner.move(start)
        return self._climb_down(_Ask(began, deadline, start, goal.cell, start != pose.cell))

    def _climb_down(self, ask: "_Ask") -> PathMessage:
        """The ladder."""
        standing = self._planner.standing()
        if standing.valid and standing.added <= self.settings.tolerance * standing.cost:
            if (message := self._standing(ask, standing, "", "it still holds")) is not None:
                return message
            standing = Standing(standing.footing.NONE)
        failures: list[tuple[str, str]] = []
        outcome = Outcome.UNKNOWN
        for origin, method in ((Origin.FULL, None), (Origin.CORRIDOR, DynamicMethod.CORRIDOR)):
            left = ask.deadline - self._clock()
            if origin is Origin.FULL and self._expected_s > max(left, _LEAST_PLANNING_S):
                failures.append(("late", "by its last times the full method would be late"))
                self._expected_s *= _FORGET
                outcome = Outcome.TIMEOUT
                continue
            if origin is Origin.CORRIDOR and left <= 0.0 and standing.valid:
                break
            plan, kind, reason = self._try(method, max(left, _LEAST_PLANNING_S))
            if plan is not None and plan.ok:
                why = failures[-1][1] if failures else plan.reason
                if (message := self._new(ask, plan, origin, why)) is not None:
                    for kind, _ in failures[:1]:
                        self._degraded[kind] += 1
                    return message
                kind, reason = "map_changed", "the map changed while planning"
            elif plan is not None and plan.status is not Status.TIMEOUT:
                return self._failure(ask.began, Outcome.of(plan.status), plan.reason or "searched everywhere", ask)
            if plan is not None and plan.status is Status.TIMEOUT:
                outcome = Outcome.TIMEOUT
            failures.append((kind, reason))
        first, last = failures[0], failures[-1]
        self._degraded[first[0]] += 1
        if standing.valid and (message := self._standing(ask, standing, first[0], first[1])) is not None:
            return message
        return self._failure(ask.began, outcome, last[1], ask, degraded=True)

    def _try(self, method: DynamicMethod | None, limit_s: float) -> tuple[Plan | None, str, str]:
        """A plan, or None where it raised; what kind of failure it is, and why."""
        began = self._clock()
        try:
            plan = self._planner.replan(method=method, time_limit_s=limit_s)
        except Exception as error:
            where = "corridor" if method else "full"
            _LOG.warning("planning by %s raised", method or self.settings.method, exc_info=True)
            self.count_error(where)
            return None, "raised", _told(error)
        if method is None:
            took = self._clock() - began
            self._expected_s = (
                max(took, 0.8 * self._expected_s + 0.2 * took) if plan.ok else max(took, self._expected_s)
            )
        return plan, "timeout", "the search ran out of time"

    def _take_map(self) -> None:
        version, changes = self.world.take()
        try:
            for row, col, patch in changes:
                self._cells_changed += self._planner.update(row, col, patch)
        except Exception:
            _LOG.exception("a map update failed; the planner is made anew")
            self.count_error("map")
            self._planner = self._new_planner()
        self._version = version

    def _new_planner(self) -> DynamicPlanner:
        s = self.settings
        self._version, _ = self.world.take()
        planner = DynamicPlanner(
            self.world.cost(), (0, 0), s.method, also=(DynamicMethod.CORRIDOR,), step_cost=s.step_cost,
            omega=s.omega, corner_cutting=s.corner_cutting, model=self._model,
        )  # fmt: skip
        planner.prepare()
        return planner

    def _holds(self, cell: Cell) -> bool:
        return 0 <= cell[0] < self.world.shape[0] and 0 <= cell[1] < self.world.shape[1]

    def _nearest_passable(self, cell: Cell) -> Cell | None:
        """The cell itself, or the nearest passable one within the radius; None without any."""
        if self._planner.grid.is_passable(*cell):
            return cell
        radius = self.settings.snap_radius
        weights = self._planner.grid.map()
        top, left = max(cell[0] - radius, 0), max(cell[1] - radius, 0)
        near = weights[top : cell[0] + radius + 1, left : cell[1] + radius + 1]
        rows, cols = np.nonzero(np.isfinite(near))
        away = (rows + top - cell[0]) ** 2 + (cols + left - cell[1]) ** 2
        within = away <= radius * radius
        if not within.any():
            return None
        at = int(np.argmin(np.where(within, away, np.iinfo(np.int64).max)))
        return int(rows[at]) + top, int(cols[at]) + left

    def _standing(self, ask: "_Ask", standing: Standing, degraded: str, reason: str) -> PathMessage | None:
        plan = self._planner.path.plan
        assert plan is not None
        path = plan.path[standing.index :]
        return self._message(
            ask, Origin.STANDING, path, standing.cost, standing.lower_bound, plan.by, reason, bool(degraded)
        )

    def _new(self, ask: "_Ask", plan: Plan, origin: Origin, reason: str) -> PathMessage | None:
        degraded = origin is not Origin.FULL
        return self._message(ask, origin, plan.path, plan.cost, plan.lower_bound, plan.by, reason, degraded)

    def _message(
        self, ask: "_Ask", origin: Origin, path: NDArray[np.int32], cost: float, lower_bound: float, method: str,
        reason: str, degraded: bool,
    ) -> PathMessage | None:  # fmt: skip
        """The answer, or None where the path does not hold on the newest map."""
        ends = (tuple(path[0]), tuple(path[-1])) == (ask.start, ask.goal) if len(path) else False
        if (why := self.world.refuses(path, self.settings.corner_cutting)) or not ends:
            _LOG.info("a path from %s is held back: %s", origin, why or "its ends are others")
            return None
        return PathMessage(
            self._ticks, Outcome.OK, origin, path, ask.start, ask.goal, ask.start_moved, degraded, cost, lower_bound,
            method, reason, self._version, 1e3 * (self._clock() - ask.began),
        )  # fmt: skip

    def _failure(
        self, began: float, outcome: Outcome, reason: str, ask: "_Ask | None" = None, *, degraded: bool = False
    ) -> PathMessage:
        return PathMessage(
            self._ticks, outcome, Origin.NONE, start=ask.start if ask else None, goal=ask.goal if ask else None,
            start_moved=bool(ask and ask.start_moved), degraded=degraded, reason=reason, map_version=self._version,
            planning_ms=1e3 * (self._clock() - began),
        )  # fmt: skip


@dataclass(frozen=True)
class _Ask:
    """What a tick is to answer."""

    began: float
    deadline: float
    start: Cell
    goal: Cell
    start_moved: bool


def _told(error: Exception) -> str:
    """An error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
