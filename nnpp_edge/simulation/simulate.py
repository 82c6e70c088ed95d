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
from nnpp_edge.runtime.arrays import Cells, Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.connections import Recorder
from nnpp_edge.runtime.loop.timing import Histogram
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.memory import rss_bytes
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.simulation.ground import SurveyedGround
from nnpp_edge.simulation.scene import Scene, SimulationSettings
from nnpp_edge.terrain.facts import Fact, values_of
from nnpp_edge.terrain.labels import random_query

_COUNTED = ("ticks", "planned", "kept", "failed", "degraded", "errors", "drops", "overruns")
PERIOD_S = 0.1
"""Answers that take longer are late where no rate is given."""
_TRIES = 50
_PATIENCE = 50
"""Ticks without a step after which a robot that drives on and on gets another goal."""
_WARM_UP = 0.1
"""Share of the ticks after which memory is read again."""
_LEAST_DISTANCE = 0.6
"""Between a random start and goal, as a share of the map's longer side."""


@dataclass(frozen=True, eq=False)
class DriveOutcome:
    """Outcome of a drive; of an endless one ways, costs and `reached` are those to the
    last goal.
    """

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
    goals: int
    """That were reached."""
    memory_mb: dict[str, float]
    """Of the process: at the first tick (``start``), after a tenth of those allowed (``tenth``), at
    the ``end``.
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
        names = ("method", "start", "goal", "reached", "goals", "memory_mb", "planning_ms")
        told = {name: getattr(self, name) for name in names} | values_of(self.facts)
        return told | {name: getattr(self.counters, name) for name in _COUNTED}


def random_drive(ground: SurveyedGround, seed: int) -> tuple[Cell, Cell]:
    """A start and a goal that are far apart and truly connected; InvalidQueryError if there are
    none to be found.
    """
    return _connected(Planner(ground.ground), ground.costs(), np.random.default_rng([seed, 1]))


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
    rng = np.random.default_rng([settings.seed, 2])
    scene = Scene(ground, start, goal, rng, settings)
    course = _Course(scene, settings, rng)
    told = ground.as_told(scene.told)
    navigator = Navigator(told, settings.method, model=settings.model, **settings.steps)
    sinks = list(make_sinks(navigator.map))
    recorders = [sink for sink in sinks if isinstance(sink, Recorder)]
    source = RecordedSource(scene, recorders, navigator.count_error, wait=True)

    def after_tick(message: PathMessage) -> None:
        course.count(message)
        if watch is not None:
            watch(scene, message)
        if course.over():
            loop.finish()

    paced = settings.rate_hz is not None
    rate_hz = settings.rate_hz or 1.0 / PERIOD_S
    loop = Loop(navigator, source, sinks, rate_hz=rate_hz, paced=paced, after_tick=after_tick)
    with closing(source):
        counters = loop.run(settings.ticks)
    return course.drive(counters if paced else replace(counters, overruns=course.late))


class _Course:
    """A drive under way: its figures tick by tick, and the optimum to the goal at hand.

    InvalidQueryError where no path leads to the goal.
    """

    def __init__(
        self,
        scene: Scene,
        settings: SimulationSettings,
        rng: np.random.Generator,
    ) -> None:
        self._scene = scene
        self._settings = settings
        self._rng = rng
        self._planner = Planner(scene.ground.ground, **settings.steps)
        self._costs = scene.ground.costs()
        self._planner.touch()  # what the scene needs is not to look like growth of the loop
        self._best = self._optimum()
        if not self._best.ok:
            goal = scene.ground.in_file(scene.goal)
            start = scene.ground.in_file(scene.robot)
            raise InvalidQueryError(
                f"the goal {goal} cannot be reached from {start}: {self._best.status}"
            )
        self._histogram = Histogram()
        self._memory_mb: dict[str, float] = {}
        self._goals = 0
        self._waited = 0
        self._stuck = 0
        """Ticks since the robot last took a step."""
        self.late = 0
        """Answers that took longer than a tick has."""

    def _optimum(self) -> Plan:
        return self._planner.plan(self._scene.robot, self._scene.goal, method="astar")

    def count(self, message: PathMessage) -> None:
        """Count a tick, and tell the scene its answer."""
        self._histogram.add(1e-3 * message.planning_ms)
        self.late += message.planning_ms > 1e3 * PERIOD_S
        if message.tick in (1, 1 + int(_WARM_UP * self._settings.ticks)):
            self._memory_mb["tenth" if self._memory_mb else "start"] = 1e-6 * rss_bytes()
        self._stuck = self._stuck + 1 if self._scene.waited > self._waited else 0
        self._waited = self._scene.waited
        self._scene.heard(message)
        self._goals += self._scene.reached

    def over(self) -> bool:
        """Whether the drive has ended; an endless one is sent to another goal."""
        scene = self._scene
        if not self._settings.endless:
            return scene.reached
        if scene.reached or self._stuck > _PATIENCE:
            self._stuck = 0
            scene.send_to(_connected(self._planner, self._costs, self._rng, scene.robot)[1])
            self._best = self._optimum()
        return False

    def drive(self, counters: Counters) -> DriveOutcome:
        """The drive so far, as it is told to users."""
        scene = self._scene
        driven = np.array(scene.driven, np.int32)
        return DriveOutcome(
            self._settings.method,
            (int(driven[0, 0]), int(driven[0, 1])),
            scene.goal,
            scene.reached,
            counters,
            waited=scene.waited,
            forbidden=scene.forbidden,
            driven_cost=self._planner.state.grid.costs_of(driven)[0],
            optimal_cost=self._best.cost,
            goals=self._goals,
            memory_mb=self._memory_mb | {"end": 1e-6 * rss_bytes()},
            planning_ms=self._histogram.summary_ms(),
            driven=driven[:, :2],
            optimal=self._best.path,
        )


def _connected(
    planner: Planner,
    costs: Float2D,
    rng: np.random.Generator,
    start: Cell | None = None,
) -> Endpoints:
    """A start, if none is given, and a goal."""
    least = _LEAST_DISTANCE * max(costs.shape)
    for _ in range(_TRIES):
        ends = random_query(rng, costs, least)
        if ends is not None and start is not None:
            ends = (start, ends[1])
        if ends and ends[0] != ends[1] and planner.plan(*ends, method="corridor").ok:
            return ends
    raise InvalidQueryError(
        f"no two connected cells {least:.0f} apart were found on the map; give start and goal"
    )
