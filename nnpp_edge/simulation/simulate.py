"""A simulated robot drives to its goal through the onboard loop, over ground that the map knows only roughly."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.robot.transports.recording import RecordedSource
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.connections import Sink
from nnpp_edge.runtime.loop.ladder import NavigatorSettings
from nnpp_edge.runtime.loop.messages import Counters, Goal, PathMessage, Pose
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.runner import Loop
from nnpp_edge.runtime.loop.timing import Histogram
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.simulation.scene import Scene, SurveyedGround
from nnpp_edge.terrain.labels import random_query

_COUNTED = ("ticks", "planned", "kept", "failed", "degraded", "errors", "drops", "overruns")
PERIOD_S = 0.1
"""Time that a tick has for its answer where no rate is given."""
_TRIES = 50
_LEAST_DISTANCE = 0.6
"""Between a random start and goal, as a share of the map's longer side."""

Watch = Callable[[Scene, PathMessage], None]


@dataclass(frozen=True)
class SimulationSettings:
    """How a drive goes."""

    method: str = "auto"
    model: str = "edge"
    rate_hz: float | None = None
    """Ticks a second; None for as fast as possible, each with a tenth of a second for its answer."""
    ticks: int = 5000
    """The drive ends after so many, at the goal or not."""
    changes: int = 1
    """Events of obstacles between two ticks: one appears, moves or vanishes."""
    sight: int = 12
    """Cells that the robot sees to each side, beyond those under its body."""
    speed: int = 1
    """Cells that it walks between two ticks."""
    seed: int = 1
    """Of the obstacles."""

    def __post_init__(self) -> None:
        if self.rate_hz is not None and not 0.0 < self.rate_hz < math.inf:
            raise InvalidQueryError(f"the rate must be a positive number of ticks a second, got {self.rate_hz}")
        if self.ticks < 1:
            raise InvalidQueryError(f"ticks must be at least 1, got {self.ticks}")


@dataclass(frozen=True, eq=False)
class Drive:
    """Outcome of a drive."""

    method: str
    start: Cell
    goal: Cell
    reached: bool
    counters: Counters
    waited: int
    """Times that the robot stood still."""
    forbidden: int
    """Published paths that crossed a cell, or a pose of the vehicle, that the map forbade by then; checked apart from
    the loop. 0, or the loop is at fault."""
    driven_cost: float
    """Of the cells that the robot walked over, by the true costs without obstacles."""
    optimal_cost: float
    """Of the best path that anyone could have walked, knowing all of the ground and meeting no obstacle."""
    planning_ms: dict[str, float]
    """``p50``, ``p90``, ``p99``, ``max``, ``mean`` of a tick's answer."""
    driven: NDArray[np.int32] = field(repr=False)
    """(N, 2) cells in the order walked."""
    optimal: NDArray[np.int32] = field(repr=False)

    @property
    def excess(self) -> float | None:
        """By which share the drive cost more than the optimum; None where the goal was not reached."""
        if not self.reached:
            return None
        return self.driven_cost / self.optimal_cost - 1.0 if self.optimal_cost else 0.0

    def summary(self) -> dict[str, object]:
        """Without its arrays, ready for JSON."""
        values: dict[str, object] = asdict(self) | {"excess": self.excess, "cells": len(self.driven)}
        for name in ("driven", "optimal", "counters"):
            del values[name]
        return values | {name: getattr(self.counters, name) for name in _COUNTED}


def random_drive(ground: SurveyedGround, seed: int) -> tuple[Cell, Cell]:
    """A start and a goal that are far apart and truly connected; InvalidQueryError if there are none to be found."""
    rng = np.random.default_rng([seed, 1])
    costs, planner = ground.costs(), ground.planner()
    least = _LEAST_DISTANCE * max(ground.true.shape)
    for _ in range(_TRIES):
        query = random_query(rng, costs, least)
        if query is not None and planner.plan(*query, method="corridor").ok:
            return query
    raise InvalidQueryError(f"no two connected cells {least:.0f} apart were found on the map; give start and goal")


def simulate(
    ground: SurveyedGround,
    start: Cell,
    goal: Cell,
    settings: SimulationSettings | None = None,
    *,
    make_sinks: Callable[[MapState], Sequence[Sink]] = lambda state: (),
    watch: Watch = lambda scene, message: None,
) -> Drive:
    """Drive from start to goal over ground whose truth decides, and whose survey is the robot's first map.

    `make_sinks` makes the sinks of the answers, given the loop's map; those with a method `record` get the inputs
    too, each with its seconds since the begin. `watch` is called after every tick, with the scene and the answer, in
    the loop's thread. InvalidQueryError where start or goal is impassable or outside, or no path connects them even
    without obstacles.
    """
    settings = settings or SimulationSettings()
    rng = np.random.default_rng([settings.seed, 2])
    scene = Scene(ground, start, goal, rng, sight=settings.sight, speed=settings.speed, changes=settings.changes)
    planner = ground.planner()
    best = planner.plan(start, goal, method="astar")
    if not best.ok:
        raise InvalidQueryError(f"the goal {goal} cannot be reached from {start}: {best.status}")
    planning = NavigatorSettings(method=settings.method, model=settings.model)
    first = Navigator(ground.robot.ground(scene.told), planning)
    first.offer(Pose(*scene.robot))
    first.offer(Goal(*scene.goal))
    first.tick()  # beside the drive: what a process loads only once is no part of a tick
    navigator = Navigator(ground.robot.ground(scene.told), planning)
    sinks = list(make_sinks(navigator.map))
    recorders = [sink.record for sink in sinks if hasattr(sink, "record")]
    source = RecordedSource(scene, recorders, navigator.count_error, wait=True)
    histogram, late = Histogram(), Counter[bool]()

    def after_tick(message: PathMessage) -> None:
        histogram.add(1e-3 * message.planning_ms)
        late[message.planning_ms > 1e3 * PERIOD_S] += 1
        scene.heard(message)
        watch(scene, message)
        if scene.reached:
            loop.finish()

    paced = settings.rate_hz is not None
    rate_hz = settings.rate_hz or 1.0 / PERIOD_S
    loop = Loop(navigator, source, sinks, rate_hz=rate_hz, paced=paced, after_tick=after_tick)
    with source:
        counters = loop.run(settings.ticks)
    if not paced:
        counters = replace(counters, overruns=late[True])
    driven = np.array(scene.driven, np.int32)
    return Drive(
        settings.method,
        start,
        goal,
        scene.reached,
        counters,
        waited=scene.waited,
        forbidden=scene.forbidden,
        driven_cost=planner.state.grid.costs_of(driven)[0],
        optimal_cost=best.cost,
        planning_ms=histogram.summary_ms(),
        driven=driven,
        optimal=best.path,
    )
