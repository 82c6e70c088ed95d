"""Tiny plans that go through every code path with every type of argument which the runtime hands to its kernels."""

import functools
import warnings
from collections.abc import Callable
from functools import partial

import numpy as np

from nnpp_edge.runtime import tuning
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.kernels.encoding import GAUSSIAN_CHANNELS
from nnpp_edge.runtime.kernels.threshold import lowered
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.poses import pose_costs
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.state import MapState, map_state
from nnpp_edge.runtime.network.encoding import encode_gaussian
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.methods import Methods
from nnpp_edge.runtime.planners.plan import DynamicMethod
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.planners.query import Query, Work
from nnpp_edge.runtime.planners.refine import BodyLines
from nnpp_edge.runtime.planners.windowed import connected
from nnpp_edge.runtime.region.learned import RegionFinder
from nnpp_edge.runtime.search.astar import cost_field
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

_SMALL = (40, 56)
_NARROW = 24
"""Columns of the maps that are long: what counts is their longer side."""


@functools.cache
def exercise() -> None:
    """Make tiny plans that call every kernel with every set of argument types, once in a process.

    What is not yet loaded would else be waited for by some later query: up to a tenth of a second for each kernel.
    """
    for part in parts():
        part()


def parts() -> list[Callable[[], None]]:
    """The parts of `exercise`, which can be done in any order."""
    network = NetworkModel("edge")
    dem = np.cumsum(np.random.default_rng(0).normal(0.0, 0.1, (150, 24)), axis=1).astype(np.float32)
    dem[3, 4] = np.nan
    return [
        *(partial(_exercise_elevations, heights, network) for heights in (dem, _read_only(dem))),
        partial(_exercise_body, dem, network),
        partial(_exercise_directed, dem, network),
        partial(_exercise_network, network),
        *(partial(_exercise_planner, shape, "paper", True, network) for shape in warmup_shapes()),
        *(
            partial(_exercise_planner, _SMALL, step_cost, corner_cutting, network)
            for step_cost, corner_cutting in (("paper", False), ("length", True), ("length", False))
        ),
    ]


def _exercise_network(network: NetworkModel) -> None:
    network.try_out()
    size = 16
    encode_gaussian((1.0, 2.0), (9.0, 3.0), 4.0, np.empty((GAUSSIAN_CHANNELS, size, size), np.float32))
    finder = RegionFinder(size)
    finder.threshold((1, 2), (9, 3))
    finder.mark(lowered(3, 0.5), (1, 2), (9, 3), 1)


def _exercise_elevations(heights: Float2D, network: NetworkModel) -> None:
    limits = Traversability(hard_slope_deg=25.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SaturationWarning)
        cost = traversability_cost(heights, 1.0, limits, cell_width_m=1.5)
    update_cost(cost, heights, (70, 5, 2, 3), 1.0, limits)
    terrain_terms(heights, 1.0)
    for lazy in (True, False):
        planner = Planner.of_elevation(heights, 1.0, limits, lazy=lazy, model=network, ask_from=0, warn=False)
        for method in ("astar", "corridor", "nnpp"):
            path = planner.plan((1, 2), (140, 20), method=method).path
        planner.state.grid.walk(path, 0, np.empty(len(path)))
        planner.update_elevation(3, 4, heights[:5, :6].copy())
        planner.update_elevation(0, 0, heights)
    connected([cost], ((0, 0), (1, 1)))


def _exercise_body(dem: Float2D, network: NetworkModel) -> None:
    vehicle, (start, goal) = Vehicle(2.2, 2.2, 3.0, max_tilt_deg=60.0, unknown_passes=True), ((8, 5), (140, 18))
    planner = Planner.of_elevation(dem, 1.0, vehicle=vehicle, model=network, ask_from=0, warn=False)
    for method in ("astar", "corridor"):
        planner.plan(start, goal, method=method, refine="any-angle")
        planner.plan(start, goal, method=method, time_limit_s=60.0)
    coarse = CoarseLevel(planner.state.pyramid.levels[1])
    nothing = np.zeros((2 * coarse.grid.rows, 2 * coarse.grid.cols), np.int32)
    region, memory = Region(nothing, *planner.state.pyramid.levels[0].quarters, 1), planner.state.grid.weights
    coarse.close_dead_ends(region, Workspace(len(memory)), planner.state.shape)
    BodyLines(planner.state.grid).attitudes(np.array((start, goal), np.float64))
    planner.prepare(landmarks=1, goals=[goal])
    for method in ("astar", "corridor"):
        planner.plan(start, goal, method=method)
    planner.update_elevation(3, 4, dem[:5, :6].copy())
    pose_costs(dem[:148], 1.0, vehicle)
    moving = DynamicPlanner.of_elevation(
        dem, 1.0, goal, method="dstar", vehicle=vehicle, also=("corridor-dstar",), model=network
    )
    moving.move(start)
    for method in ("dstar", "corridor-dstar"):
        moving.replan(method=method)
        moving.update_elevation(3, 4, dem[:5, :6] + np.float32(0.01))
        moving.standing()
    state = map_state(Ground.of_elevation(dem, 1.0, vehicle=vehicle))
    _mend_corridor(Methods(state, network), Query(start, goal))


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
        _mend_corridor(Methods(moving.state, network), Query(start, goal))


def warmup_shapes() -> list[tuple[int, int]]:
    """Maps below and above every size at which something is done in another way."""
    sizes = sorted({size for size in vars(tuning).values() if isinstance(size, MapSize)})
    return [_SMALL, *((size + 8, _NARROW if size > 500 else size * 2 // 3) for size in sizes)]


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
            search.plan(at, deadline=Deadline.within(60.0))
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
    methods = Methods(map_state(Ground(cost, step_cost=step_cost), corner_cutting=corner_cutting), network)
    _mend_corridor(methods, Query((1, 2), goal))
    methods.find(DynamicMethod.CORRIDOR_DSTAR, Query((1, 2), goal), Work())


def _mend_corridor(methods: Methods, query: Query) -> None:
    methods.corridor(query, Work(), methods.always_mending)


def _read_only(array: Float2D) -> Float2D:
    """A contiguous copy that may not be written, as a memory-mapped file is: to numba that is another type."""
    out = array.copy()
    out.flags.writeable = False
    return out
