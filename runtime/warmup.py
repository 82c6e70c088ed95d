"""Compiling every kernel before the first plan: at install or at boot, rather than on the way.

Tiny plans are made that go through every code path with every type of argument which the runtime hands to
its kernels. What they compile stays in the cache folder that `compiled` chose.
"""

import functools
import importlib
import os
import pkgutil
import re
import shutil
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import nnpp_edge.runtime
from nnpp_edge.runtime import tuning
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.compiled import cache, kernel
from nnpp_edge.runtime.compiled.cache import NumbaObject
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.kernels.encoding import GAUSSIAN_CHANNELS
from nnpp_edge.runtime.map.crossing import costs_of_crossing
from nnpp_edge.runtime.map.poses import pose_costs
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.network.encoding import encode_gaussian
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.map_planners import MapPlanners
from nnpp_edge.runtime.planners.plan import DynamicMethod
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.planners.query import Query, Work
from nnpp_edge.runtime.planners.refine import BodyLines
from nnpp_edge.runtime.region.corridor import CoarseLevel
from nnpp_edge.runtime.region.links import Links, LinkSearch
from nnpp_edge.runtime.region.threshold import RegionFinder, lowered
from nnpp_edge.runtime.search.astar import cost_field
from nnpp_edge.runtime.search.connection import connected
from nnpp_edge.runtime.search.dstar_lite import DStarLite
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.traversability import (
    SaturationWarning,
    Traversability,
    terrain_terms,
    traversability_cost,
    update_cost,
)
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.runtime.tuning import MapSize

_FOLDER_NAME = re.compile(r"kernels-.+-[0-9a-f]{8}")
_STILL_IN_USE_S = 3600.0
"""A folder written to within this time may belong to a process that is still running: it is left alone."""
_NARROW = 24
"""Columns of the maps that are long: what counts is their longer side."""


@dataclass(frozen=True)
class Warmth:
    """What a warm-up came to."""

    folder: Path
    """Where the compiled kernels are."""
    kernels: int
    """Kernels in it."""
    signatures: int
    """Their versions, one for each set of argument types."""
    compiled: int
    """Versions that were compiled this time; the rest was there already."""
    seconds: float
    removed: tuple[Path, ...]
    """Folders of other versions that were deleted."""

    def summary(self) -> dict[str, object]:
        """Ready for JSON."""
        told = asdict(self)
        return told | {
            "folder": str(self.folder),
            "seconds": round(self.seconds, 3),
            "removed": [str(folder) for folder in self.removed],
        }


def warm_up(*, keep_old: bool = False) -> Warmth:
    """Compile every kernel into the cache folder; later processes load them from there.

    Parameters
    ----------
    keep_old : bool
        Leave the kernels of other versions where they are. Otherwise their folders are deleted, but for
        those written to within the last hour.

    Raises
    ------
    OutputError
        There is no folder to write to, or it cannot be written.
    """
    folder = kernel.CACHE_FOLDER
    if folder is None:
        raise OutputError(
            "compiled kernels cannot be kept: wanted a folder that only this user can write to, found none "
            "(set NUMBA_CACHE_DIR to such a folder)"
        )
    began = time.perf_counter()
    try:
        with _alone(folder), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of a kernel that is not kept: an error below
            before = _compilations()
            exercise()
            compiled = _compilations() - before
        if cache.save_error is not None:
            raise cache.save_error
        removed = () if keep_old else _remove_old(folder)
    except OSError as error:
        raise OutputError(f"{folder}: kernels could not be kept ({error.strerror or error})") from error
    kernels, signatures = cache.count_kept(folder)
    return Warmth(folder, kernels, signatures, compiled, time.perf_counter() - began, removed)


@functools.cache
def exercise() -> None:
    """Make tiny plans that call every kernel with every set of argument types, once in a process.

    What is not yet loaded would else be waited for by some later query: up to a tenth of a second for each kernel.
    """
    network = NetworkModel("edge")
    _exercise_elevations(network)
    network.set_query((0.0, 0.0), (1.0, 1.0))
    network.run()
    for shape in warmup_shapes():
        for step_cost in ("paper", "length"):
            for corner_cutting in (True, False):
                _exercise_planner(shape, step_cost, corner_cutting, network)
    size = 16
    encode_gaussian((1.0, 2.0), (9.0, 3.0), size, 1, 4.0, np.empty((GAUSSIAN_CHANNELS, size, size), np.float32))
    finder = RegionFinder(size)
    finder.threshold((1, 2), (9, 3))
    finder.mark(lowered(3, 0.5), (1, 2), (9, 3), 1)


def _exercise_elevations(network: NetworkModel) -> None:
    dem = np.cumsum(np.random.default_rng(0).normal(0.0, 0.1, (150, 24)), axis=1).astype(np.float32)
    dem[3, 4] = np.nan
    limits = Traversability(hard_slope_deg=25.0)
    for heights in (dem, _read_only(dem)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SaturationWarning)
            cost = traversability_cost(heights, 1.0, limits, cell_width_m=1.5)
        update_cost(cost, heights, (70, 5, 2, 3), 1.0, limits)
        terrain_terms(heights, 1.0)
        for lazy in (True, False):
            planner = Planner.of_elevation(heights, 1.0, limits, lazy=lazy, model=network, ask_from=0, warn=False)
            for method in ("astar", "corridor", "nnpp"):
                planner.plan((1, 2), (140, 20), method=method)
            planner.update_elevation(3, 4, heights[:5, :6].copy())
            planner.update_elevation(0, 0, heights)
    _exercise_body(dem, network)
    _exercise_directed(dem, network)
    _exercise_passage(dem)
    connected([cost], ((0, 0), (1, 1)))


def _exercise_body(dem: Float2D, network: NetworkModel) -> None:
    vehicle, (start, goal) = Vehicle(2.2, 2.2, 3.0, max_tilt_deg=60.0, unknown_passes=True), ((8, 5), (140, 18))
    planner = Planner.of_elevation(dem, 1.0, vehicle=vehicle, model=network, ask_from=0, warn=False)
    for method in ("astar", "corridor"):
        planner.plan(start, goal, method=method, refine="any-angle")
        planner.plan(start, goal, method=method, time_limit_s=60.0)
    BodyLines(planner.state.grid).attitudes(np.array((start, goal), np.float64))
    planner.plan(start, goal, method="corridor", price="sampled")
    planner.prepare(landmarks=1, goals=[goal])
    for method in ("astar", "corridor"):
        planner.plan(start, goal, method=method)
    planner.update_elevation(3, 4, dem[:5, :6].copy())
    costs_of_crossing(pose_costs(dem[:148], 1.0, vehicle), 10.0)
    moving = DynamicPlanner.of_elevation(
        dem, 1.0, goal, method="dstar", vehicle=vehicle, also=("corridor-dstar",), model=network
    )
    moving.move(start)
    for method in ("dstar", "corridor-dstar"):
        moving.replan(method=method)
        moving.update_elevation(3, 4, dem[:5, :6] + np.float32(0.01))
        moving.standing()
    state = MapState.of_elevation(dem, (1.0, 1.0), Traversability(), StepModel.of("paper"), vehicle=vehicle)
    MapPlanners(state, network).corridor_mended.find(Query(start, goal), Work())


def _exercise_directed(dem: Float2D, network: NetworkModel) -> None:
    """Steps that cost by the slope: on a map with one coarse level, on one with two, and of a body."""
    body, long = Vehicle(2.2, 2.2, 3.0, max_tilt_deg=60.0, unknown_passes=True), np.tile(dem, (8, 1))
    for heights, vehicle, start in ((dem, None, (1, 2)), (long, None, (1, 2)), (dem, body, (8, 5))):
        goal = (heights.shape[0] - 10, 18)
        planner = Planner.of_elevation(
            heights, 1.0, vehicle=vehicle, step_cost="tobler", model=network, ask_from=0, warn=False
        )
        for method in ("astar", "corridor", "nnpp"):
            planner.plan(start, goal, method=method)
        planner.update_elevation(3, 4, dem[:5, :6].copy())
        cost_field(planner.state.grid, start, Workspace(len(planner.state.grid.weights)))
    for vehicle in (None, body):
        moving = DynamicPlanner.of_elevation(
            dem,
            1.0,
            goal,
            method="dstar",
            vehicle=vehicle,
            step_cost="tobler",
            also=("corridor-dstar",),
            model=network,
        )
        moving.move(start)
        moving.replan()
        moving.update_elevation(3, 4, dem[:5, :6] + np.float32(0.01))
        moving.standing()
        moving.replan()
        MapPlanners(moving.state, network).corridor_mended.find(Query(start, goal), Work())


def _exercise_passage(dem: Float2D) -> None:
    vehicle, (start, goal) = Vehicle(3.5, 2.2, 1.2, max_tilt_deg=35.0, unknown_passes=True), ((8, 5), (140, 18))
    dem = np.float32(0.2) * dem  # gentle enough for the vehicle to stand at both ends
    for heights in (dem, _read_only(dem)):
        planner = Planner.of_elevation(heights, 1.0, vehicle=vehicle, warn=False)
        planner.plan(start, goal, method="corridor", price="network")
        planner.update_elevation(3, 4, dem[:5, :6].copy())
        planner.plan(start, goal, method="corridor", price="network")
    search, links, memory = LinkSearch(dem.shape), Links.all_at(5.0, dem.shape), Workspace((150 + 2) * (24 + 2))
    region, _ = search.around(links, (start, goal), 0.1, 1)
    memory.next_stamp()
    search.around_again(search.without_dead_ends(links, region, memory), (start, goal), 0.1, 1)


def warmup_shapes() -> list[tuple[int, int]]:
    """Maps below and above every size at which something is done in another way."""
    sizes = sorted({size for size in vars(tuning).values() if isinstance(size, MapSize)})
    return [(40, 56), *((size + 8, _NARROW if size > 1000 else size * 2 // 3) for size in sizes)]


def _exercise_planner(shape: tuple[int, int], step_cost: str, corner_cutting: bool, network: NetworkModel) -> None:
    cost = np.random.default_rng(0).uniform(0.1, 0.6, shape).astype(np.float32)
    start, goal = (1, 2), (shape[0] - 2, shape[1] - 3)
    for weights in (cost, _read_only(cost)):
        planner = Planner(weights, step_cost=step_cost, corner_cutting=corner_cutting, model=network)
        for method in ("astar", "corridor", "nnpp"):
            planner.plan(start, goal, method=method)
            planner.plan(goal, start, method=method, time_limit_s=60.0, refine="any-angle")
            planner.plan(start, start, method=method)
        planner.plan(start, goal, method="astar", time_limit_s=0.0)
        for patch in (cost[:5, :6].copy(), _read_only(cost[:5, :6])):
            planner.update(3, 4, patch)
        planner.prepare(landmarks=1, goals=[goal])
        for method in ("astar", "corridor"):
            planner.plan(start, goal, method=method)
        planner.nearest(start, [goal], method="astar")
        planner.update(shape[0] // 2, 0, np.full((1, shape[1]), np.inf, np.float32))  # a wall: no path
        for method in ("astar", "corridor", "nnpp"):
            planner.plan(start, goal, method=method)
    _exercise_searches(planner.state, start, corner_cutting)
    _exercise_dynamic(cost, goal, step_cost, corner_cutting, network)


def _exercise_searches(state: MapState, start: Cell, corner_cutting: bool) -> None:
    for level in state.pyramid.levels[1:]:
        coarse = CoarseLevel(level)
        coarse.set_landmarks(1)
        coarse.search((0, 0), (level.grid.rows - 1, 0), None, beyond=0.02)
    cost_field(state.grid, start, Workspace(len(state.grid.weights)))
    search = DStarLite(state, (9, 12))
    for region in (None, Region.everywhere(*state.shape), None):
        search.set_region(region)
        for at in ((1, 2), (2, 2)):
            search.plan(at)
            search.plan(at, deadline=time.monotonic() + 60.0)
            state.update(1, 4, np.full((1, 2), 0.5, np.float32))
            search.reach()


def _exercise_dynamic(cost: Float2D, goal: Cell, step_cost: str, corner_cutting: bool, network: NetworkModel) -> None:
    planner = DynamicPlanner(
        cost, goal, also=tuple(DynamicMethod), step_cost=step_cost, corner_cutting=corner_cutting, model=network
    )
    planner.prepare()
    rows, cols = planner.shape
    for at, method in enumerate(DynamicMethod):
        planner.move((1, 2 + at))
        planner.replan(method=method)
        part = (rows // 4, cols // 4)  # enough that the network's view is compared with what it saw
        for patch in (np.full(part, 0.3 + 0.02 * at, np.float32), _read_only(np.full((1, 2), 0.31, np.float32))):
            planner.update(1, 4, patch)
        planner.standing()
        planner.replan(method=method, time_limit_s=60.0)
    planners = MapPlanners(MapState(cost, StepModel.of(step_cost), corner_cutting=corner_cutting), network)
    for planner_of_region in (planners.corridor_mended, planners.corridor_mending):
        planner_of_region.find(Query((1, 2), goal), Work())


def _read_only(array: Float2D) -> Float2D:
    """A contiguous copy that may not be written, as a memory-mapped file is: to numba that is another type."""
    out = array.copy()
    out.flags.writeable = False
    return out


def kernels() -> dict[str, NumbaObject]:
    """Every kernel of the runtime by its full name."""
    found = {}
    prefix = nnpp_edge.runtime.__name__ + "."
    for info in pkgutil.walk_packages(nnpp_edge.runtime.__path__, prefix):
        module = importlib.import_module(info.name)
        for name, value in vars(module).items():
            if hasattr(value, "py_func") and value.py_func.__module__ == module.__name__:
                found[f"{module.__name__}.{name}"] = value
    return found


def _compilations() -> int:
    return sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels().values())


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait until no other warm-up works for `folder`: the second finds what the first has compiled."""
    try:
        import fcntl
    except ImportError:  # not on this system
        yield
        return
    descriptor = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _remove_old(folder: Path) -> tuple[Path, ...]:
    """Delete what other versions left beside `folder`; what cannot be deleted stays."""
    removed = []
    for other in sorted(folder.parent.iterdir()):
        if other == folder or other.is_symlink() or not other.is_dir() or not _FOLDER_NAME.fullmatch(other.name):
            continue
        if other.stat().st_uid != os.geteuid() or time.time() - _last_written(other) < _STILL_IN_USE_S:
            continue
        shutil.rmtree(other, ignore_errors=True)
        if not other.exists():
            removed.append(other)
    return tuple(removed)


def _last_written(folder: Path) -> float:
    return max((path.lstat().st_mtime for path in (folder, *folder.rglob("*"))), default=0.0)
