"""The onboard loop for many ticks on a map that never rests: does it keep time, memory and its word?

``python -m nnpp_edge.benchmarks.soak --ticks 60000 --size 512`` drives a robot from goal to goal, ticks as fast as
possible, with changes of the map at every tick, and checks each path apart from the loop. With ``--vehicle`` it has a
body, gets patches of the heights around it, and is told of walls as costs, which come and go. With ``--refine`` the
lines of a disc are checked too.
"""

import itertools
import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from nnpp_edge.profiling.suites import TerrainFiles, check_sizes, heights_of, synthetic_cases, terrain_cases
from nnpp_edge.progress import bar
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError, NnppEdgeError, Status
from nnpp_edge.runtime.loop.ladder import NavigatorSettings
from nnpp_edge.runtime.loop.messages import Input, MapPatch, PathMessage
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.runner import Loop
from nnpp_edge.runtime.loop.timing import rss_bytes
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.planners.plan import DynamicMethod
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.simulation.robots import Body, Disc
from nnpp_edge.simulation.scene import Scene, SurveyedGround, walkable
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.labels import random_query
from nnpp_edge.terrain.rocks import with_rocks
from nnpp_edge.terrain.vehicle_files import load_vehicle

RATE_HZ = 17.0
"""The rate at which late ticks are counted (the paper's rover plans at 17 Hz)."""
_WARM_UP = 0.1
"""Share of the ticks after which memory is read for the first time."""
_PATIENCE = 50
"""Ticks without a path, or without a step, after which the robot gets another goal."""
_TRIES = 200
_TOLD = 0.1
"""Share of the ticks at which a body is told something as costs."""
_TOUCHES = 1.0 - 1e-4
"""Share of its radius from which on a disc touches: way points are float32."""


def soak(
    settings: NavigatorSettings,
    ground: SurveyedGround,
    *,
    ticks: int,
    changes: int = 1,
    seed: int = 1,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, object]:
    """Let one method plan for `ticks` (at least 1) on ground of at least 32 cells a side; see `soak_ground`.

    At every tick `changes` obstacles appear, move or vanish. InvalidQueryError if a number is out of range.

    Returns
    -------
    dict
        Counts: ``goals`` that the robot was sent to, ``reached``, ``planned``, ``kept``, ``errors``;
        ``without_path``, ticks whose answer was not OK, as obstacles can wall the robot or its goal in; ``invalid``,
        paths that crossed what the newest map forbids, or were broken: 0, or the loop is at fault; ``overruns``,
        ticks longer than a period at 17 Hz. ``ticks_per_s`` and ``tick_ms`` are by the time spent in ticks, without
        the simulated world's; resident memory, MB, is that at the start, after a tenth of the ticks
        (``rss_warm_mb``) and at the end.
    """
    size = min(ground.true.shape)
    if ticks < 1 or size < 32:
        raise InvalidQueryError(f"a soak needs at least 1 tick and a map of 32 cells, got {ticks} and {size}")
    course = _Course(ground, np.random.default_rng(seed), changes)
    memory_mb = {"rss_start_mb": 1e-6 * rss_bytes()}
    overruns = failed = 0

    def after_tick(answer: PathMessage) -> None:
        nonlocal overruns, failed
        _, began, ended, _ = loop.spans[0]
        overruns += ended - began > 1.0 / RATE_HZ
        failed += answer.outcome is not Status.OK
        if answer.tick == 1 + int(_WARM_UP * ticks):
            memory_mb["rss_warm_mb"] = 1e-6 * rss_bytes()
        if answer.tick % 100 == 0 or answer.tick == ticks:
            progress(answer.tick)
        course.heard(answer)

    navigator = Navigator(ground.robot.ground(course.scene.told), settings)
    loop = Loop(navigator, course, rate_hz=RATE_HZ, paced=False, after_tick=after_tick)
    counters = loop.run(ticks)
    return {
        "method": str(settings.method),
        "ticks": ticks,
        "size": size,
        "changes": changes,
        "goals": course.goals,
        "reached": course.reached,
        "planned": counters.planned,
        "kept": counters.kept,
        "without_path": failed,
        "invalid": course.scene.forbidden + course.forbidden,
        "errors": counters.errors,
        "ticks_per_s": 1e3 / counters.tick_ms["mean"],
        "tick_ms": counters.tick_ms,
        "overruns": overruns,
        **memory_mb,
        "rss_end_mb": 1e-6 * rss_bytes(),
    }


class _Course:
    """A scene without end, moved on between ticks: where a goal is reached, or cannot be, the next follows."""

    def __init__(self, ground: SurveyedGround, rng: np.random.Generator, changes: int) -> None:
        self._ground, self._rng = ground, rng
        self._planner, self._costs = ground.planner(), ground.costs()
        self._planner.touch()  # what the course needs is not to look like growth of the loop
        self.goals, self.reached, self._stuck = 1, 0, 0
        start, goal = self._query(None)
        self.scene = Scene(ground, start, goal, rng, changes=changes)
        self._told, self.forbidden = np.zeros(ground.true.shape, np.bool_), 0
        """(H, W) cells told to be impassable, beside the heights; paths and lines that crossed what they must not."""
        self._next = list(self.scene.poll())

    def poll(self) -> list[Input]:
        """The inputs of the next tick."""
        return self._next

    def heard(self, answer: PathMessage) -> None:
        """Check an answer by what was told, and a disc's line by its distance; then move on."""
        scene, robot = self.scene, self._ground.robot
        scene.heard(answer)
        if answer.ok and self._told.any():
            values = np.where(self._told, np.float32(np.nan), scene.told)
            self.forbidden += not walkable(robot, answer.path, values, answer.goal)
        if answer.waypoints is not None and isinstance(robot, Disc):
            legs = itertools.pairwise(np.asarray(answer.waypoints))
            steps = [np.linspace(*leg, 2 + 4 * int(np.abs(np.diff(leg, axis=0)).max())) for leg in legs]
            self.forbidden += robot.clearance_m(scene.told, np.concatenate(steps)) < _TOUCHES * robot.radius_m
        waited = scene.waited
        self._next = list(scene.poll())
        if isinstance(robot, Body) and self._rng.random() < _TOLD:
            self._next.append(self._wall())
        self._stuck = self._stuck + 1 if scene.waited > waited else 0
        if scene.reached or self._stuck > _PATIENCE:
            self.reached += scene.reached
            self.goals, self._stuck = self.goals + 1, 0
            del scene.driven[:-1]  # the way so far is not to look like growth of the loop
            self._next += scene.send_to(self._query(scene.robot)[1])

    def _wall(self) -> MapPatch:
        """A wall told as costs, away from both ends; or what was told there is taken back, or nothing is said."""
        rows, cols = self._ground.true.shape
        far = 3 * self._ground.robot.reach
        row, col = int(self._rng.integers(rows - 4)), int(self._rng.integers(cols - 4))
        near = min(max(abs(row - end[0]), abs(col - end[1])) for end in (self.scene.robot, self.scene.goal)) < far
        value = float(self._rng.choice((math.nan, 0.0, 1.0)))
        high, wide = ((1, 4), (4, 1))[int(self._rng.integers(2))]
        if near or value == 0.0:  # all that was told, now and then
            row, col, value, high, wide = 0, 0, 0.0, rows, cols
        if not math.isnan(value):
            self._told[row : row + high, col : col + wide] = value >= 1.0
        return MapPatch(row, col, cost=np.full((high, wide), value))

    def _query(self, robot: Cell | None) -> Endpoints:
        """A start (the robot's cell) and a goal that is far from it and truly connected."""
        for _ in range(_TRIES):
            query = random_query(self._rng, self._costs, 0.4 * len(self._costs))
            if query is None:
                continue
            start = query[0] if robot is None else robot
            if start != query[1] and self._planner.plan(start, query[1], method="corridor").ok:
                return start, query[1]
        raise InvalidQueryError(f"no goal was found in {_TRIES} tries")


def soak_ground(
    size: int, seed: int = 1, dems: Sequence[Dem] = (), vehicle: Vehicle | None = None, rocks: float = 0.0
) -> SurveyedGround:
    """A part of the terrain, or synthetic ground, `size` cells a side, with rocks on a share of it.

    What the robot's first map lacks are obstacles, and rocks. InvalidQueryError if a terrain is smaller.
    """
    workload = "limit20" if vehicle is None or vehicle.is_disc else "body"
    check_sizes(dems, (size,))
    made = synthetic_cases(workload, size, seed, vehicle=vehicle)
    below = next(terrain_cases(dems, workload, size, seed, vehicle=vehicle) if dems else made).ground
    assert below is not None
    bare, (height_m, width_m), limits = heights_of(below), below.sides_m, below.traversability
    heights = with_rocks(bare, height_m, rocks, seed, cell_width_m=width_m) if rocks else bare
    ground = Ground.of_elevation(heights, height_m, limits, cell_width_m=width_m, vehicle=vehicle)
    return SurveyedGround.of(ground, 1, bare)


@click.command()
@click.option("--ticks", type=click.IntRange(1), default=60_000, show_default=True)
@click.option("--size", type=click.IntRange(32), default=512, show_default=True, help="Side of the map.")
@click.option("--terrain", multiple=True, type=click.Path(path_type=Path), help="Elevation file; else synthetic.")
@click.option("--rescale", type=float, help="Rescale the terrain to cells of so many metres, slopes kept.")
@click.option("--vehicle", metavar="NAME|FILE", help="A shipped vehicle, or one from TOML.")
@click.option("--rocks", type=click.FloatRange(0.0, 0.2), default=0.0, help="Share of the ground under rocks.")
@click.option("--changes", type=click.IntRange(0), default=1, show_default=True, help="Of the map, at every tick.")
@click.option("--method", type=click.Choice([*map(str, DynamicMethod)]), default="auto", show_default=True)
@click.option("--model", default="edge", show_default=True, help="Shipped model or file.")
@click.option("--refine", is_flag=True, help="Plan lines off the grid too.")
@click.option("--seed", type=int, default=1, show_default=True)
def main(ticks: int, method: str, model: str, refine: bool, changes: int, seed: int, **of_ground: Any) -> None:
    """Plan for many ticks and print what came of it as JSON; exit code 1 if a path was invalid."""
    vehicle = None if of_ground["vehicle"] is None else load_vehicle(of_ground["vehicle"])
    dems = TerrainFiles(of_ground["terrain"], of_ground["rescale"]).read()
    ground = soak_ground(of_ground["size"], seed, dems, vehicle, of_ground["rocks"])
    settings = NavigatorSettings(method=method, model=model, refine="any-angle" if refine else None)
    with bar(f"soak {method}", ticks, quiet=True) as advance:
        row = soak(settings, ground, ticks=ticks, changes=changes, seed=seed, progress=advance)
    click.echo(json.dumps(row, indent=1))
    sys.exit(int(bool(row["invalid"])))


if __name__ == "__main__":
    try:
        main()
    except NnppEdgeError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(2)
