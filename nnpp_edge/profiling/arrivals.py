"""Times of maps and patches of elevations that have just arrived: to the first path, and to a checked one."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.profile_file import OnboardLoop
from nnpp_edge.profiling.rivals import RivalPlanner
from nnpp_edge.profiling.suites import heights_of
from nnpp_edge.profiling.trace import Trace
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.loop.ladder import NavigatorSettings
from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, Origin, Output, PathMessage, Pose
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.runner import Loop
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.planners.planner import Planner

REACTIONS = 120
"""Patches that the loop is given in each half of a run: seven seconds at 17 Hz."""
_PATCH_SIDE = 64
_WARM_UP = 4
"""Patches before these, whose times do not count."""
_QUERIES = 4
"""Most queries of a map that share the patches: on one, hills might lie in an odd place."""
_PLACES = (0.35, 0.5, 0.65)
"""Where on the path hills appear, as shares of its cells."""


def patch_side(shape: tuple[int, ...]) -> int:
    """Cells to a side of the patches that a map of this shape gets: 64, on small maps a quarter of its side."""
    return min(_PATCH_SIDE, max(min(shape) // 4, 1))


def arrival_ms(rival: RivalPlanner, ground: Ground, query: Endpoints, harness: Harness) -> tuple[float, float]:
    """Milliseconds from elevations to the path, and of a patch on that path into all that the next plan reads.

    The rival must be `apart`: its network is shown the map anew.
    """

    def arrive() -> tuple[Planner, Plan]:
        planner = Planner(ground, model=rival.model or "edge")
        return planner, planner.plan(*query, method=rival.method)

    map_s, (planner, plan) = harness.timed(arrive)
    patch = _patch(ground, plan.path if plan.ok else np.array(query[:1]), 0.5)

    def take_patch() -> None:
        planner.update_elevation(*patch)
        if rival.method is not Method.ASTAR:  # which reads no coarse levels
            _ = planner.state.pyramid

    patch_s, _ = harness.timed(take_patch)
    return 1e3 * map_s, 1e3 * patch_s


@dataclass
class Reactions:
    """Answers of the onboard loop to patches, one at each tick."""

    ms: list[float] = field(default_factory=list)
    """From each patch's arrival to the path being published."""
    planned: int = 0
    """Answers with a new path."""
    kept: int = 0
    """Answers with the standing path."""
    without_path: int = 0


def reactions(
    ground: Ground,
    queries: Sequence[Endpoints],
    loop: OnboardLoop,
    patches: int = REACTIONS,
    clock: Callable[[], float] = time.perf_counter,
    trace: Trace | None = None,
) -> Reactions:
    """Run the onboard loop at its rate on this map, with a patch of elevations at each tick.

    With every other patch a hill appears on the newest path; with the next it is gone. The first of the queries share
    the patches. `trace` is given every tick.
    """
    settings = NavigatorSettings(
        loop.method, corner_cutting=loop.corner_cutting, model=loop.model, tolerance=loop.tolerance
    )
    hills = _Hills(ground, list(_script(queries[:_QUERIES], patches)), clock)
    running = Loop(
        Navigator(ground, settings),
        hills,
        [hills],
        rate_hz=loop.rate_hz,
        cores=loop.cores,
        priority=loop.priority,
        after_tick=None if trace is None else lambda message: trace.tick(message, running.spans),
    )
    running.run(len(hills.script))
    found = Reactions()
    for turn, arrived, (published, message) in zip(hills.script, hills.arrived, hills.answers, strict=True):
        if turn is True:
            found.ms.append(1e3 * (published - arrived))
            found.planned += message.ok and message.origin is not Origin.STANDING
            found.kept += message.origin is Origin.STANDING
            found.without_path += not message.ok
    return found


_Turn = Endpoints | bool
"""Input of a tick: another query, or a patch, which counts or does not."""


def _script(queries: Sequence[Endpoints], patches: int) -> Iterator[_Turn]:
    """Inputs of each tick. After an even number of patches no hill is left."""
    for at, query in enumerate(queries):
        yield query
        yield from (False,) * (0 if at else _WARM_UP)
        first, end = (patches * number // len(queries) for number in (at, at + 1))
        yield from (True,) * (end - first)
        yield from (False,) * ((end - first) % 2)


class _Hills:
    """The loop's source and its sink: hills come and go on the path that was published last."""

    name = "hills"

    def __init__(self, ground: Ground, script: Sequence[_Turn], clock: Callable[[], float]) -> None:
        self._ground, self.script, self._clock = ground, script, clock
        self._hill: tuple[int, int] | None = None
        self._path = np.array(script[0])
        self.arrived: list[float] = []
        """When the inputs of each tick came."""
        self.answers: list[tuple[float, PathMessage]] = []
        """When the answer of each tick was published, and the answer."""

    def poll(self) -> Iterator[Input]:
        """The inputs of the next tick."""
        turn = self.script[len(self.arrived)]
        messages: list[Input] = [self._next()] if isinstance(turn, bool) else [Pose(*turn[0]), Goal(*turn[1])]
        self.arrived.append(self._clock())
        return iter(messages)

    def publish(self, message: Output) -> None:
        """An answer of the loop."""
        now = self._clock()
        if isinstance(message, PathMessage):
            self.answers.append((now, message))
            if message.ok:
                self._path = message.path

    def _next(self) -> MapPatch:
        """A hill on the path, or the ground as it was where one stands."""
        if self._hill is None:
            row, col, heights = _patch(self._ground, self._path, _PLACES[len(self.arrived) % len(_PLACES)])
            self._hill = row, col
        else:
            (row, col), side = self._hill, patch_side(self._ground.shape)
            heights, self._hill = heights_of(self._ground)[row : row + side, col : col + side], None
        return MapPatch(row, col, elevation=heights)


def _patch(ground: Ground, path: np.ndarray, share: float) -> tuple[int, int, np.ndarray]:
    """First row and column, and heights in metres, of a square with a hill too steep for most rovers: 42°.

    It lies around the cell at this share of a path.
    """
    side, cell = patch_side(ground.shape), path[int(share * len(path))].tolist()
    row, col = (min(max(at - side // 2, 0), n - side) for at, n in zip(cell, ground.shape, strict=True))
    along = (np.arange(side) - 0.5 * (side - 1)) / (side / 6.0)
    bump = np.exp(-0.5 * (along[:, None] ** 2 + along**2))
    height_m = 1.5 * side / 6.0 * ground.sides_m[0]
    heights = heights_of(ground)[row : row + side, col : col + side] + height_m * bump
    return row, col, heights.astype(np.float32)
