"""A simulated robot drives to its goal through the onboard loop, over ground that the map knows
only roughly.
"""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace

import numpy as np

from nnpp_edge.outcome import gap
from nnpp_edge.robot.transports.recording import RecordedSource
from nnpp_edge.runtime import (
    Counters,
    Loop,
    Navigator,
    PathMessage,
    Planner,
    Sink,
)
from nnpp_edge.runtime.arrays import Cells
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.connections import Recorder
from nnpp_edge.runtime.loop.timing import Histogram
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.simulation.ground import SurveyedGround
from nnpp_edge.simulation.scene import Scene, SimulationSettings
from nnpp_edge.terrain.facts import Fact, values_of
from nnpp_edge.terrain.labels import random_query

_COUNTED = ("ticks", "planned", "kept", "failed", "degraded", "errors", "drops", "overruns")
PERIOD_S = 0.1
"""Answers that take longer are late where no rate is given."""
_TRIES = 50
_LEAST_DISTANCE = 0.6
"""Between a random start and goal, as a share of the map's longer side."""


@dataclass(frozen=True, eq=False)
class DriveOutcome:
    """Outcome of a drive."""

    method: str
    start: Cell
    goal: Cell
    reached: bool
    counters: Counters
    waited: int
    """Times that the robot stood still."""
    forbidden: int
    """Published paths that crossed a cell, or a pose of the vehicle, that the map forbade by
    then; checked apart from the loop. 0, or the loop is at fault."""
    driven_cost: float
    """Of the cells that the robot walked over, by the true costs without obstacles."""
    optimal_cost: float
    """Of the best path that anyone could have walked, knowing all of the ground and meeting no
    obstacle.
    """
    planning_ms: dict[str, float]
    """``p50``, ``p90``, ``p99``, ``max``, ``mean`` of a tick's answer."""
    driven: Cells = field(repr=False)
    """(N, 2) in the order walked."""
    optimal: Cells = field(repr=False)

    @property
    def excess(self) -> float | None:
        """By which share the drive cost more than the optimum; None where the goal was
        not reached.
        """
        if not self.reached:
            return None
        return gap(self.driven_cost, self.optimal_cost)

    @property
    def facts(self) -> list[Fact]:
        """What is known of the way driven, for all outputs."""
        moved = np.diff(self.driven, axis=0).any(axis=1)  # not where it turned on the spot
        excess = "" if self.excess is None else f": driven {100.0 * self.excess:+.1f} %"
        optimum = f"optimum: {{}} with all known and no obstacle{excess}"
        return [
            Fact("cells", 1 + int(moved.sum()), "", "driven: {} cells"),
            Fact("driven_cost", self.driven_cost, "", "driven: cost {}"),
            Fact("waited", self.waited, "", "driven: stood still {} times"),
            Fact("optimal_cost", self.optimal_cost, "", optimum),
            Fact("excess", self.excess),
            Fact("forbidden", self.forbidden, "", "forbidden: {} of the paths published"),
        ]

    def summary(self) -> dict[str, object]:
        """Without its arrays, ready for JSON."""
        names = ("method", "start", "goal", "reached", "planning_ms")
        told = {name: getattr(self, name) for name in names} | values_of(self.facts)
        return told | {name: getattr(self.counters, name) for name in _COUNTED}


def random_drive(ground: SurveyedGround, seed: int) -> tuple[Cell, Cell]:
    """A start and a goal that are far apart and truly connected; InvalidQueryError if there are
    none to be found.
    """
    planner = Planner(ground.ground)
    costs = ground.costs()
    rng = np.random.default_rng([seed, 1])
    least = _LEAST_DISTANCE * max(costs.shape)
    for _ in range(_TRIES):
        ends = random_query(rng, costs, least)
        if ends and planner.plan(*ends, method="corridor").ok:
            return ends
    raise InvalidQueryError(
        f"no two connected cells {least:.0f} apart were found on the map; give start and goal"
    )


def simulate(
    ground: SurveyedGround,
    start: Cell,
    goal: Cell,
    settings: SimulationSettings | None = None,
    *,
    make_sinks: Callable[[MapState], Sequence[Sink]] = lambda state: (),
    watch: Callable[[Scene, PathMessage], None] | None = None,
) -> DriveOutcome:
    """Drive from start to goal over ground whose truth decides, and whose survey is the robot's
    first map.

    `make_sinks` makes the sinks of the answers, given the loop's map; those with a method `record`
    get the inputs too, each with its seconds since the begin. `watch` is called after every tick,
    with the scene and the answer, in the loop's thread. InvalidQueryError where start or goal is
    impassable or outside, or no path connects them even without obstacles.
    """
    settings = settings or SimulationSettings()
    scene = Scene(ground, start, goal, np.random.default_rng([settings.seed, 2]), settings)
    planner = Planner(ground.ground, **settings.steps)
    best = planner.plan(start, goal, method="astar")
    if not best.ok:
        ends = f"{ground.in_file(goal)} cannot be reached from {ground.in_file(start)}"
        raise InvalidQueryError(f"the goal {ends}: {best.status}")
    told = ground.as_told(scene.told)
    navigator = Navigator(told, settings.method, model=settings.model, **settings.steps)
    sinks = list(make_sinks(navigator.map))
    recorders = [sink for sink in sinks if isinstance(sink, Recorder)]
    source = RecordedSource(scene, recorders, navigator.count_error, wait=True)
    answers = Histogram()
    late = 0

    def after_tick(message: PathMessage) -> None:
        nonlocal late
        answers.add(1e-3 * message.planning_ms)
        late += message.planning_ms > 1e3 * PERIOD_S
        scene.heard(message)
        if watch is not None:
            watch(scene, message)
        if scene.reached:
            loop.finish()

    paced = settings.rate_hz is not None
    rate_hz = settings.rate_hz or 1.0 / PERIOD_S
    loop = Loop(navigator, source, sinks, rate_hz=rate_hz, paced=paced, after_tick=after_tick)
    with closing(source):
        counters = loop.run(settings.ticks)
    driven = np.array(scene.driven, np.int32)
    return DriveOutcome(
        settings.method,
        start,
        goal,
        scene.reached,
        counters if paced else replace(counters, overruns=late),
        waited=scene.waited,
        forbidden=scene.forbidden,
        driven_cost=planner.state.grid.costs_of(driven)[0],
        optimal_cost=best.cost,
        planning_ms=answers.summary_ms(),
        driven=driven[:, :2],
        optimal=best.path,
    )
