"""Times of maps and patches of elevations that have just arrived: to the first path, and to a
checked one.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.rivals import RivalPlanner
from nnpp_edge.profiling.rows import Rows
from nnpp_edge.profiling.suites import heights_of
from nnpp_edge.runtime.cells import Endpoints, slices
from nnpp_edge.runtime.loop.connections import InProcessSource
from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, Origin, PathMessage, Pose
from nnpp_edge.runtime.loop.runner import Loop
from nnpp_edge.runtime.loop.settings import OnboardLoop
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.planners.planner import Planner

_PATCH_SIDE = 64
_WARM_UP = 2
"""Hills before these, whose times do not count."""
_QUERIES = 4
"""Most queries of a map that share the patches: on one, hills might lie in an odd place."""
_PLACES = (0.35, 0.5, 0.65)
"""Where on the path hills appear, as shares of its cells."""


def patch_side(shape: tuple[int, ...]) -> int:
    """Cells to a side of the patches that a map of this shape gets: 64, on small maps a quarter of
    its side.
    """
    return min(_PATCH_SIDE, max(min(shape) // 4, 1))


def arrival_ms(
    rival: RivalPlanner,
    ground: Ground,
    query: Endpoints,
    harness: Harness,
) -> tuple[float, float]:
    """Milliseconds from elevations to the path, and of a patch on that path into all that the next
    plan reads.

    The rival must be `apart`: its network is shown the map anew."""

    def arrive() -> tuple[Planner, Plan]:
        planner = Planner(ground, model=rival.model or "edge")
        return planner, planner.plan(*query, method=rival.method)

    def take_patch() -> None:
        planner.update_elevation(*patch)
        if rival.method is not Method.ASTAR:  # which reads no coarse levels
            _ = planner.state.pyramid

    map_s, (planner, plan) = harness.timed(arrive)
    path = plan.path if plan.ok else np.array(query[:1])
    patch = _patch(ground, path, 0.5)
    patch_s, _ = harness.timed(take_patch)
    return 1e3 * map_s, 1e3 * patch_s


def reactions(
    ground: Ground,
    queries: Sequence[Endpoints],
    loop: OnboardLoop,
    patches: int,
) -> Rows:
    """Run the onboard loop at its rate on this map, with a patch of elevations at each tick: a row
    for each answer, with ``reaction_ms`` from the loop's reading of the patch to the path being
    handed on.

    With every other patch a hill appears on the newest path; with the next it is gone. The first of
    the queries share the patches.
    """
    source = InProcessSource()
    found = Rows()
    path = np.array(queries[0])
    counts = False
    queries = queries[:_QUERIES]
    hills = max(patches // (2 * len(queries)), 1)
    inputs = _inputs(ground, queries, hills, lambda: path)

    def feed() -> None:
        nonlocal counts
        messages, counts = next(inputs, ([], False))
        for message in messages:
            source.put(message)

    def after_tick(message: PathMessage) -> None:
        nonlocal path
        if counts:
            kept = message.origin is Origin.STANDING
            row = {
                "reaction_ms": 1e3 * running.tick_s,
                "planned": message.ok and not kept,
                "kept": kept,
                "without_path": not message.ok,
                "late": running.tick_s > 1.0 / loop.rate_hz,
            }
            found.append(row)
        path = message.path if message.ok else path
        feed()

    running = Loop(
        loop.navigator(ground),
        source,
        rate_hz=loop.rate_hz,
        cores=loop.cores,
        priority=loop.priority,
        after_tick=after_tick,
    )
    feed()
    running.run(2 * _WARM_UP + len(queries) * (1 + 2 * hills))
    return found


def _inputs(
    ground: Ground,
    queries: Sequence[Endpoints],
    hills: int,
    newest: Callable[[], np.ndarray],
) -> Iterator[tuple[list[Input], bool]]:
    """Inputs of each tick, and whether its answer counts: each query, and hills that come and go on
    its paths."""
    for at, (start, goal) in enumerate(queries):
        yield [Pose(*start), Goal(*goal)], False
        for number in range(0 if at else -_WARM_UP, hills):
            row, col, hill = _patch(ground, newest(), _PLACES[number % len(_PLACES)])
            level = heights_of(ground)[slices((row, col, *hill.shape))]
            yield [MapPatch(row, col, elevation=hill)], number >= 0
            yield [MapPatch(row, col, elevation=level)], number >= 0


def _patch(ground: Ground, path: np.ndarray, share: float) -> tuple[int, int, np.ndarray]:
    """First row and column, and heights in metres, of a square with a hill too steep for most
    rovers: 42°.

    It lies around the cell at this share of a path.
    """
    side = patch_side(ground.shape)
    middle = path[int(share * len(path))]
    last = np.subtract(ground.shape, side)
    row, col = np.clip(middle - side // 2, 0, last).tolist()
    along = (np.arange(side) - 0.5 * (side - 1)) / (side / 6.0)
    bump = np.exp(-0.5 * (along[:, None] ** 2 + along**2))
    height_m = 1.5 * side / 6.0 * ground.sides_m[0]
    heights = heights_of(ground)[slices((row, col, side, side))] + height_m * bump
    return row, col, heights.astype(np.float32)
