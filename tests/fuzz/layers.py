"""Drives of the loop through patches of heights, costs and nothing, beside a map that keeps the
layers apart. Of some maps the means of blocks are all that is known at first.
"""

import random
from typing import Any

import numpy as np

from nnpp_edge.runtime import (
    EnergyCost,
    Ground,
    MapPatch,
    Mobility,
    Navigator,
    PathMessage,
    Planner,
    Pose,
    Status,
    Traversability,
    Vehicle,
    traversability_cost,
)
from nnpp_edge.runtime.loop.messages import Goal
from tests import pose_oracles
from tests.fuzz.cases import NOWHERE, Case, Place, Problem

CELL_M = 0.5
FACTOR = 4
DISC = Vehicle(radius_m=0.7)
VEHICLES = (None, None, DISC, Vehicle(length_m=1.4, width_m=1.0, clearance_m=0.3))
METHODS = ("auto", "auto", "astar", "dstar", "corridor", "corridor-dstar")
TOLD = (0.0, 0.4, 1.0, np.inf, np.nan)
SHARES = (0.5, 0.2, 0.1, 0.1, 0.1)
SOFT = Traversability()
HARD = Traversability(hard_slope_deg=20.0)


def generate(rng: random.Random, place: Place = NOWHERE) -> Case:
    """A first map, a robot, and the patches of each tick."""
    seed = rng.getrandbits(32)
    numbers = np.random.default_rng(seed)
    rows, cols = (FACTOR * numbers.integers(3, 11, 2)).tolist()
    by_heights = rng.random() < 0.8
    vehicle = rng.choice(VEHICLES)
    by_heights |= vehicle is not None and not vehicle.is_disc
    heights = np.cumsum(numbers.normal(0.0, 0.015, (rows, cols)), axis=1).astype(np.float32)
    for _ in range(rng.randrange(8)):
        row, col = numbers.integers(0, (rows - 6, cols - 6)).tolist()
        high, wide = rng.choice(((1, 6), (6, 1)))
        heights[row : row + high, col : col + wide] += rng.choice((0.6, -0.6, np.nan))
    cost = numbers.random((rows, cols)).astype(np.float32) * 0.9
    cost[numbers.random(cost.shape) < 0.1] = rng.choice((np.nan, np.inf, 1.0))
    step_cost = rng.choice(("paper", "paper", "tobler", "energy")) if by_heights else "paper"
    coarse = by_heights and step_cost == "paper" and vehicle is not DISC and rng.random() < 0.5
    blocks = heights.reshape(rows // FACTOR, FACTOR, cols // FACTOR, FACTOR)
    return Case(
        heights=heights * (np.nan if coarse else 1.0) if by_heights else None,
        means=blocks.mean((1, 3)) if coarse else None,
        cost=cost,
        limits=rng.choice((SOFT, HARD, HARD)),
        vehicle=vehicle,
        step_cost=step_cost,
        method=rng.choice(METHODS),
        refine=rng.random() < 0.3,
        goal=(rows - 4, cols - 4),
        seed=seed,
        steps=[
            [_patch(rng, numbers, heights, by_heights) for _ in range(rng.choice((0, 1, 1, 2, 6)))]
            for _ in range(16)
        ],
    )


def _patch(
    rng: random.Random, numbers: np.random.Generator, heights: np.ndarray, by_heights: bool
) -> MapPatch:
    """Heights near those of the first map, or costs; anywhere, also off the map."""
    row, col = numbers.integers(-3, heights.shape).tolist()
    rows, cols = numbers.integers(1, (8, 8)).tolist()
    values: dict[str, Any] = {"cost": numbers.choice(TOLD, (rows, cols), p=SHARES)}
    if rng.random() < 0.15:
        values = {"cost": np.full((rows, cols), rng.choice((np.nan, 0.0, 1.0)))}
    elif by_heights and rng.random() < 0.5:
        around = np.pad(heights, 8, constant_values=np.nan)[
            row + 8 : row + rows + 8, col + 8 : col + cols + 8
        ]
        new = around + rng.choice((0.0, 0.001, 0.05)) * numbers.normal(size=around.shape)
        new[numbers.random(new.shape) < 0.05] = rng.choice((np.nan, 2.0, np.inf))
        values = {"elevation": new}
    return MapPatch(row, col, keep_known=rng.random() < 0.5, **values)


class Layers:
    """The map, kept apart from the loop's, cell by cell: heights, if there are any, and what was
    told as costs.
    """

    def __init__(
        self, heights: np.ndarray | None, cost: np.ndarray, limits: Traversability
    ) -> None:
        self.limits = limits
        self.heights = None if heights is None else heights.copy()
        self.told = cost.copy() if heights is None else np.zeros(cost.shape, np.float32)

    def put(self, patch: MapPatch) -> None:
        """Each patch into its own layer; what was not seen is unknown then, but in a layer that
        costs are told to.
        """
        values, layer = (
            (patch.elevation, self.heights) if patch.cost is None else (patch.cost, self.told)
        )
        if values is None or layer is None:
            return
        for (i, j), value in np.ndenumerate(values):
            row = patch.row + i
            col = patch.col + j
            if not (0 <= row < layer.shape[0] and 0 <= col < layer.shape[1]):
                continue
            if np.isfinite(value) or (patch.cost is not None and not np.isnan(value)):
                layer[row, col] = value
            elif not patch.keep_known and (layer is self.heights or self.heights is None):
                layer[row, col] = np.nan

    def ground(self, cell_m: float = CELL_M, **robot: Any) -> Ground:
        """The ground of the heights or, where there are none, of the costs."""
        if self.heights is None:
            return Ground(self.told, cell_size_m=cell_m, vehicle=robot.get("vehicle"))
        return Ground.of_elevation(self.heights, cell_m, self.limits, **robot)

    def cost(self, cell_m: float = CELL_M) -> np.ndarray:
        """Of both layers; what is unknown is NaN."""
        if self.heights is None:
            return self.told
        return np.maximum(
            traversability_cost(self.heights, cell_m, self.limits, warn=False), self.told
        )


def _ground(case: Case, layers: Layers) -> Ground:
    mobility = Mobility(energy=EnergyCost(50.0, 0.1))
    robot = {"vehicle": case.vehicle, "step_cost": case.step_cost, "mobility": mobility}
    if case.means is None:
        return layers.ground(**robot)
    blocks = case.means, FACTOR * CELL_M, FACTOR, case.limits
    return Ground.of_coarse(*blocks, prior="slope", **robot)


def _planner(case: Case, layers: Layers) -> Planner:
    """The planner of a robot that has had the whole map from the start."""
    disc = case.vehicle is None or case.vehicle.is_disc
    if case.means is None and (layers.heights is None or (case.step_cost == "paper" and disc)):
        return Planner(layers.cost(), vehicle=case.vehicle, cell_size_m=CELL_M)
    if case.means is None and not disc:
        known = np.where(layers.told < 1.0, layers.heights, np.float32(np.nan))
        return Planner(_ground(case, Layers(known, case.cost, case.limits)))
    planner = Planner(_ground(case, layers))
    planner.update_elevation(0, 0, layers.heights)
    planner.update(0, 0, layers.told)
    return planner


def check(case: Case, place: Place = NOWHERE) -> Problem | None:
    """What is wrong with the loop's answers, beside the map that keeps the layers apart."""
    layers = Layers(case.heights, case.cost, case.limits)
    body = case.vehicle is not None and not case.vehicle.is_disc
    refine = "any-angle" if case.refine and case.step_cost == "paper" and not body else None
    ground = _ground(case, layers)
    navigator = Navigator(ground, case.method, tolerance=1e-4, snap_radius=0, refine=refine)
    numbers = np.random.default_rng(case.seed)
    navigator.offer(Goal(*case.goal))
    at = (3, 3)
    for tick, patches in enumerate(case.steps):
        for patch in patches:
            navigator.offer(patch)
            layers.put(patch)
        navigator.offer(Pose(at[0] + 0.5, at[1] + 0.5))
        message = navigator.tick()
        told = f"tick {tick}: {message}\n{case!r}"
        if errors := navigator.counters().errors:
            return Problem(f"caught inside the loop: {', '.join(errors)}", told)
        exact = case.method in ("astar", "dstar")
        if problem := wrong_answer(message, _planner(case, layers), at, case.goal, exact=exact):
            return Problem(problem, told)
        if body and len(message.path) > 1:
            legs = np.diff(message.path, axis=0)
            places = [message.path[:-1] + share * legs for share in (0.0, 0.5, 1.0)]
            headings = np.tile(np.arctan2(legs[:, 1], legs[:, 0]), 3)
            open_to_all = np.where(layers.told < 1.0, 0.0, np.nan), CELL_M, case.vehicle
            if found := pose_oracles.breaks_at(*open_to_all, np.concatenate(places), headings):
                return Problem("a body over an obstacle or off the map", f"{found}\n{told}")
        robot = layers.ground(vehicle=case.vehicle)
        bare = layers.told if layers.heights is None else robot.costs()
        if case.means is None and not np.array_equal(
            navigator.map.cost() < 1.0, (bare < 1.0) & (layers.told < 1.0)
        ):
            return Problem("the map's costs are shut elsewhere", told)
        cells = (
            message.path[min(2, len(message.path) - 1)]
            if message.ok
            else numbers.integers(0, case.cost.shape)
        )
        at = (int(cells[0]), int(cells[1]))
        if at == case.goal:
            at = (3, 3)
    return None


def wrong_answer(
    message: PathMessage,
    planner: Planner,
    at: tuple[int, int],
    goal: tuple[int, int],
    *,
    exact: bool,
) -> str:
    """What is wrong with an answer, by a planner of the whole map; empty if nothing."""
    best = planner.plan(at, goal, method="astar")
    if message.outcome is not best.status:
        return f"{message.outcome} where the map has {best.status}"
    if message.outcome is not Status.OK:
        return ""
    cost, near = planner.state.grid.costs_of(message.path)[0], 1e-4 * abs(best.cost) + 1e-5
    legs = 1 if planner.state.grid.robot.poses is None else 2
    leaps = not np.isin(np.abs(np.diff(message.path, axis=0)).max(1), (1, legs)).all()
    if leaps or (tuple(message.path[0]), tuple(message.path[-1])) != (at, goal):
        return "published: a path with a leap or other ends"
    if not np.isfinite(cost) or cost < best.cost - near:
        return "published: a path that cannot be walked"
    if abs(message.cost - cost) > 1e-4 * abs(cost) + 1e-5:
        return "published: a cost that is not the path's"
    if message.lower_bound > best.cost + near:
        return "published: a lower bound above the optimum"
    return (
        "published: a path that is not the best"
        if exact and message.cost > best.cost + 3.0 * near
        else ""
    )
