"""Drives of the loop through patches of heights, costs and nothing, beside a map that keeps the layers apart."""

import random
from dataclasses import dataclass
from typing import Any

import numpy as np

from nnpp_edge.runtime import (
    EnergyCost,
    Ground,
    MapPatch,
    Mobility,
    Navigator,
    NavigatorSettings,
    PathMessage,
    Planner,
    Pose,
    Status,
    Traversability,
    Vehicle,
    traversability_cost,
)
from nnpp_edge.runtime.loop.messages import Goal
from nnpp_edge.runtime.planners.plan import path_costs
from tests.fuzz.commands import Problem

NAME = "layers"
CELL_M = 0.5
VEHICLES = (None, None, Vehicle(radius_m=0.7), Vehicle(length_m=1.4, width_m=1.0, clearance_m=0.3))
METHODS = ("auto", "auto", "astar", "dstar", "corridor", "corridor-dstar")
TOLD, SHARES = (0.0, 0.4, 1.0, np.inf, np.nan), (0.5, 0.2, 0.1, 0.1, 0.1)


@dataclass(frozen=True)
class Case:
    """A first map, a robot, and the patches of each tick."""

    heights: np.ndarray | None
    cost: np.ndarray
    hard: bool
    vehicle: Vehicle | None
    step_cost: str
    method: str
    refine: bool
    goal: tuple[int, int]
    seed: int
    ticks: tuple[tuple[MapPatch, ...], ...]

    def __repr__(self) -> str:
        """Without the arrays, which the seed decides."""
        facts = {name: value for name, value in vars(self).items() if name not in ("heights", "cost", "ticks")}
        return f"{facts} {self.cost.shape} heights {self.heights is not None}, {len(self.ticks)} ticks"


def generate(rng: random.Random) -> Case:
    """A case of a dozen or two of ticks."""
    seed = rng.getrandbits(32)
    numbers = np.random.default_rng(seed)
    rows, cols = numbers.integers(12, 44, 2).tolist()
    by_heights, vehicle = rng.random() < 0.8, rng.choice(VEHICLES)
    heights = np.cumsum(numbers.normal(0.0, 0.015, (rows, cols)), axis=1).astype(np.float32)
    for _ in range(rng.randrange(8)):
        row, col = numbers.integers(0, (rows - 6, cols - 6)).tolist()
        high, wide = rng.choice(((1, 6), (6, 1)))
        heights[row : row + high, col : col + wide] += rng.choice((0.6, -0.6, np.nan))
    if vehicle is not None and not vehicle.is_disc:
        by_heights = True
    cost = numbers.random((rows, cols)).astype(np.float32) * 0.9
    cost[numbers.random(cost.shape) < 0.1] = rng.choice((np.nan, np.inf, 1.0))
    ticks = [
        tuple(_patch(rng, numbers, heights, by_heights) for _ in range(rng.choice((0, 1, 1, 2, 6))))
        for _ in range(16)
    ]
    return Case(
        heights if by_heights else None,
        cost,
        rng.random() < 0.7,
        vehicle,
        rng.choice(("paper", "paper", "tobler", "energy")) if by_heights else "paper",
        rng.choice(METHODS),
        rng.random() < 0.3,
        (rows - 4, cols - 4),
        seed,
        tuple(ticks),
    )


def _patch(rng: random.Random, numbers: np.random.Generator, heights: np.ndarray, by_heights: bool) -> MapPatch:
    """Heights near those of the first map, or costs; anywhere, also off the map."""
    row, col = numbers.integers(-3, heights.shape).tolist()
    rows, cols = numbers.integers(1, (8, 8)).tolist()
    values: dict[str, Any] = {"cost": numbers.choice(TOLD, (rows, cols), p=SHARES)}
    if rng.random() < 0.15:
        values = {"cost": np.full((rows, cols), rng.choice((np.nan, 0.0, 1.0)))}
    elif by_heights and rng.random() < 0.5:
        around = np.pad(heights, 8, constant_values=np.nan)[row + 8 : row + rows + 8, col + 8 : col + cols + 8]
        new = around + rng.choice((0.0, 0.001, 0.05)) * numbers.normal(size=around.shape)
        new[numbers.random(new.shape) < 0.05] = rng.choice((np.nan, 2.0, np.inf))
        values = {"elevation": new}
    return MapPatch(row, col, keep_known=rng.random() < 0.5, **values)


class Layers:
    """The map, kept apart from the loop's, cell by cell."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.limits = Traversability(hard_slope_deg=20.0) if case.hard else Traversability()
        self.mobility = Mobility(energy=EnergyCost(50.0, 0.1))
        self.heights = None if case.heights is None else case.heights.copy()
        self.told = case.cost.copy() if case.heights is None else np.zeros(case.cost.shape, np.float32)

    def put(self, patch: MapPatch) -> None:
        """Each patch into its own layer; what was not seen is unknown then, but in a layer that costs are told to."""
        values, layer = (patch.elevation, self.heights) if patch.cost is None else (patch.cost, self.told)
        assert values is not None and layer is not None
        for (i, j), value in np.ndenumerate(values):
            row, col = patch.row + i, patch.col + j
            if not (0 <= row < layer.shape[0] and 0 <= col < layer.shape[1]):
                continue
            if np.isfinite(value) or (patch.cost is not None and not np.isnan(value)):
                layer[row, col] = value
            elif not patch.keep_known and (layer is self.heights or self.heights is None):
                layer[row, col] = np.nan

    def ground(self) -> Ground:
        """What the loop begins with."""
        if self.heights is None:
            return Ground(self.told, cell_size_m=CELL_M, vehicle=self.case.vehicle)
        return Ground.of_elevation(
            self.heights,
            CELL_M,
            self.limits,
            vehicle=self.case.vehicle,
            step_cost=self.case.step_cost,
            mobility=self.mobility,
        )

    def planner(self) -> Planner:
        """What a robot would plan on that has had the whole map from the start."""
        case, shut = self.case, ~(self.told < 1.0)
        disc = case.vehicle is None or case.vehicle.is_disc
        if self.heights is not None and case.step_cost == "paper" and disc:
            cost = traversability_cost(self.heights, CELL_M, self.limits, warn=False)
            return Planner(np.maximum(cost, self.told), vehicle=case.vehicle, cell_size_m=CELL_M)
        if self.heights is None:
            return Planner(self.told, vehicle=case.vehicle, cell_size_m=CELL_M)
        if not disc:
            self_heights, layers = self.heights, Layers(case)
            layers.heights = np.where(shut, np.float32(np.nan), self_heights)
            return Planner.on(layers.ground())
        planner = Planner.on(self.ground())
        planner.update(0, 0, np.where(shut, np.inf, 0.0))
        return planner


def check(case: Case) -> Problem | None:
    """What is wrong with the loop's answers, beside the map that keeps the layers apart."""
    layers = Layers(case)
    refine = "any-angle" if case.refine and case.step_cost == "paper" else None
    settings = NavigatorSettings(case.method, tolerance=1e-4, snap_radius=0, refine=refine)
    navigator, numbers = Navigator(layers.ground(), settings), np.random.default_rng(case.seed)
    navigator.offer(Goal(*case.goal))
    at = (3, 3)
    for tick, patches in enumerate(case.ticks):
        for patch in patches:
            navigator.offer(patch)
            layers.put(patch)
        navigator.offer(Pose(at[0] + 0.5, at[1] + 0.5))
        message = navigator.tick()
        if errors := navigator.counters().errors:
            return Problem(f"caught inside the loop: {', '.join(errors)}", f"tick {tick}: {message}\n{case!r}")
        if problem := _wrong(message, layers.planner(), at, case):
            return Problem(problem, f"tick {tick}: {message}\n{case!r}")
        bare = layers.told if layers.heights is None else layers.ground().costs()
        if not np.array_equal(navigator.map.cost() < 1.0, (bare < 1.0) & (layers.told < 1.0)):
            return Problem("the map's costs are shut elsewhere", f"tick {tick}\n{case!r}")
        at = tuple(message.path[min(2, len(message.path) - 1)].tolist()) if message.ok else _place(numbers, case)
        if at == case.goal:
            at = (3, 3)
    return None


def _place(numbers: np.random.Generator, case: Case) -> tuple[int, int]:
    row, col = numbers.integers(0, case.cost.shape).tolist()
    return row, col


def _wrong(message: PathMessage, planner: Planner, at: tuple[int, int], case: Case) -> str:
    """What is wrong with an answer, by a planner of the whole map; empty if nothing."""
    best = planner.plan(at, case.goal, method="astar")
    if message.outcome is not best.status:
        return f"{message.outcome} where the map has {best.status}"
    if message.outcome is not Status.OK:
        return ""
    cost = path_costs(planner.state.grid, message.path)[0]
    if not np.isfinite(cost):
        return "published: a path that cannot be walked"
    if abs(cost - message.cost) > 1e-4 * abs(cost) + 1e-5:
        return "published: a cost that is not the path's"
    if message.lower_bound > best.cost + 1e-4 * abs(best.cost) + 1e-5:
        return "published: a lower bound above the optimum"
    exact = case.method in ("astar", "dstar")
    if exact and message.cost > best.cost + 3e-4 * abs(best.cost) + 1e-5:
        return "published: a path that is not the best"
    return ""
