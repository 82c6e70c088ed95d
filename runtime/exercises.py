"""Tiny plans that call every kernel with every type of argument which the runtime hands to it."""

import functools
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.kernels.threshold import lowered
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.options import METHODS, STILL
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.region.learned import RegionFinder
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.traversability import (
    terrain_terms,
    traversability_cost,
)
from nnpp_edge.runtime.terrain.vehicle import Vehicle

_BODY = Vehicle(2.2, 2.2, 3.0, max_tilt_deg=60.0, unknown_passes=True)


@functools.cache
def exercise() -> None:
    """Make tiny plans that call every kernel with every set of argument types, once in a process.

    What is not yet loaded would else be waited for by some later query: up to a tenth of a second
    for each kernel.
    """
    for part in parts():
        part()


def parts() -> list[Callable[[], None]]:
    """The parts of `exercise`, which can be done in any order."""
    network = NetworkModel("edge")
    rises = np.random.default_rng(0).normal(0.0, 0.1, (150, 24))
    dem = np.cumsum(rises, axis=1).astype(np.float32)
    return [
        partial(_exercise_elevations, dem, network, None),
        partial(_exercise_elevations, dem, network, _BODY),
        partial(_exercise_kernels, dem),
        partial(_exercise_body_kernels, dem),
        partial(_exercise_costs, network),
    ]


def _exercise_elevations(dem: Float2D, network: NetworkModel, vehicle: Vehicle | None) -> None:
    """All of a map of heights at once, and plans of one that changes, where steps cost by the
    slope: what these call serves other prices, too.
    """
    goal = (140, 18)
    ground = Ground.of_elevation(dem, 1.0, vehicle=vehicle, step_cost="tobler")
    Planner(ground, lazy=False)
    moving = DynamicPlanner(ground, goal, model=network)
    moving.move((8, 5))
    kept = [name for name, entry in METHODS.items() if entry.keeps]
    # kept ones twice: what has changed since is mended; none of them is for a body
    for method in ("corridor",) if vehicle is not None else 2 * kept:
        moving.replan(method=method)
        moving.update_elevation(3, 4, dem[:5, :6] + np.float32(0.01))


def _exercise_costs(network: NetworkModel) -> None:
    """Plans on costs."""
    cost = np.random.default_rng(0).uniform(0.1, 0.6, (200, 128)).astype(np.float32)
    start = (1, 2)
    goal = (198, 125)
    planner = Planner(_read_only(cost), model=network)
    for method in STILL:
        planner.plan(start, goal, method=method, refine="any-angle")
    moving = DynamicPlanner(cost, goal, model=network)
    moving.move(start)
    large = np.full((50, 32), 0.3, np.float32)
    for method in DynamicMethod:
        for patch in (large, _read_only(cost[:1, :2])):
            moving.replan(method=method)
            moving.update(1, 4, patch)
            moving.standing()


def _read_only(array: Float2D) -> Float2D:
    """A contiguous copy that may not be written, as a memory-mapped file is: to numba that is
    another type.
    """
    out = array.copy()
    out.flags.writeable = False
    return out


def _exercise_kernels(dem: Float2D) -> None:
    """Kernels that plans alone do not call."""
    traversability_cost(dem, 1.0, cell_width_m=1.5, warn=False)
    terrain_terms(dem, 1.0)
    finder = RegionFinder(16)
    finder.threshold((1, 2), (9, 3))
    finder.mark(lowered(3, 0.5), (1, 2), (9, 3), 1)


def _exercise_body_kernels(dem: Float2D) -> None:
    car = replace(_BODY, turning_radius_m=3.0, reverse_cost=2.0, gear_change_m=1.0)
    planner = Planner.of_elevation(np.zeros_like(dem), 1.0, vehicle=car, warn=False)
    planner.plan((20, 12), (130, 12), start_heading_deg=90.0, goal_heading_deg=90.0)
    planner.explain((70, 12), 0.0)
    state = planner.state
    finest, above, *_ = state.pyramid.levels
    memory = Workspace(len(finest.grid.weights))
    nothing = np.zeros((2 * above.grid.rows, 2 * above.grid.cols), np.int32)
    region = Region(nothing, *finest.quarters, 1)
    CoarseLevel(above, finest).close_dead_ends(region, memory, state.shape)
