"""Robots on maps that change, and by Dijkstra what their paths cost: every planner is held to the
same table of robots and maps.
"""

import itertools
import math
from dataclasses import replace
from functools import partial
from operator import methodcaller
from typing import ClassVar

import numpy as np

from nnpp_edge.runtime import DynamicPlanner, Ground, Planner, Vehicle, traversability_cost
from nnpp_edge.runtime.kernels.poses import FAILS
from nnpp_edge.runtime.robots.body.arcs import heading_deg
from nnpp_edge.runtime.robots.slope.cost import SLOPE_COSTS
from tests import directed_cases, oracles, pose_oracles
from tests.directed_cases import MOBILITY, MODELS
from tests.fuzz import bodies
from tests.pose_oracles import DIRECTIONS
from tests.strategies import KINDS, put, random_costs, random_patch, scrambled

OMEGA = 0.011
ROVER = Vehicle(1.3, 0.9, 0.3, wheel_length_m=0.21, wheel_width_m=0.13)
CAR = replace(ROVER, turning_radius_m=1.1)
CARS = (
    CAR,
    replace(CAR, reverse_cost=1.5),
    replace(CAR, reverse_cost=2.0, gear_change_m=0.7, turning_radius_m=0.6),
    replace(CAR, turns_on_spot=True, reverse_cost=3.0, gear_change_m=0.4),
)


class World:
    """A point or a disc, on costs or on heights that patches change."""

    layers: ClassVar = {}
    """Numbers beside heights, by name."""

    def __init__(self, rng, layers, sides, limits=None, *, step_cost="paper", vehicle=None):
        self.rng = rng
        self.dem, self.told = layers
        self.sides = sides
        self.relief_m = sides[0]
        self.limits = limits
        self.step_cost = step_cost
        self.vehicle = vehicle
        self.model = MOBILITY.model(step_cost) if step_cost in SLOPE_COSTS else None
        self.corner_cutting = bool(rng.integers(2))
        self.omega = float(rng.choice((OMEGA, OMEGA, 0.0)))
        self.read()

    def ground(self):
        """The map as it is, but for what costs tell beside heights."""
        robot = {"vehicle": self.vehicle, "step_cost": self.step_cost}
        if self.dem is None:
            return Ground(self.told, cell_size_m=self.sides[0], **robot)
        robot |= {"cell_width_m": self.sides[1], "mobility": MOBILITY, "layers": self.layers}
        return Ground.of_elevation(self.dem, self.sides[0], self.limits, **robot)

    def planner(self, *towards, **options):
        """A new planner of the map; with a goal and a method one for a map that changes."""
        options |= {"corner_cutting": self.corner_cutting, "omega": self.omega}
        made = (DynamicPlanner if towards else Planner)(self.ground(), *towards, **options)
        if self.dem is not None and self.told.any():
            made.update(0, 0, self.told)
        return made

    def read(self):
        """Read what the map's cells cost now, inf where they are impassable."""
        cost = self.told if self.dem is None else np.maximum(self.by_heights(), self.told)
        self.passable = np.isfinite(cost) & ((cost < 1.0) | (self.step_cost == "length"))
        self.cost = np.where(self.passable, cost, np.float32(np.inf))
        if self.vehicle and self.vehicle.radius_m:  # as of costs, where its distances are tested
            ground = Ground(self.cost, None, *self.sides, vehicle=self.vehicle)
            self.cost = Planner(ground, omega=1.0 / 255.0).state.grid.map()
            self.passable = np.isfinite(self.cost)

    def by_heights(self):
        """(H, W) what cells cost by their heights."""
        size, width = self.sides
        return traversability_cost(self.dem, size, self.limits, cell_width_m=width, warn=False)

    def patch(self):
        """Change a part of the map, which is then to be `read`; the call that tells a planner."""
        if self.dem is None:
            row, col, patch = self.patch_of_costs()
            put(self.told, row, col, patch)
            return methodcaller("update", row, col, patch)
        row, col = (int(self.rng.integers(side)) for side in self.dem.shape)
        part = slice(row, row + self.rng.integers(1, 7)), slice(col, col + self.rng.integers(1, 7))
        if self.rng.random() < 0.2:
            patch = self.rng.choice((0.0, 1.0), self.told[part].shape)
            self.told[part] = patch
            return methodcaller("update", row, col, patch)
        here = self.dem[part]
        known = self.dem[np.isfinite(self.dem)]
        mean = float(known.mean()) if known.size else 0.0
        kinds = (
            np.full(here.shape, np.nan),
            np.where(np.isfinite(here), here, mean)
            + self.rng.normal(0.0, 0.3 * self.relief_m, here.shape),
            np.full(here.shape, mean),
            here + self.rng.normal(0.0, 0.5 * self.relief_m),
        )
        self.dem[part] = kinds[self.rng.integers(4)]
        return methodcaller("update_elevation", row, col, here.copy())

    def patch_of_costs(self):
        """Where, and new costs."""
        if self.rng.random() < 0.1:
            return 0, 0, self.told * np.float32(self.rng.choice((0.5, 1.2)))
        return random_patch(self.rng, self.told, self.step_cost)

    @property
    def rule(self):
        """What steps of costs cost, as oracles take it."""
        return self.step_cost, self.corner_cutting, self.omega

    @property
    def symmetric(self):
        """Whether paths cost the same both ways."""
        return self.model is None and not (self.vehicle and self.vehicle.turning_radius_m)

    def cells(self, count):
        """So many cells, passable if there are any."""
        found = np.argwhere(self.passable) if self.passable.any() else np.zeros((1, 2), int)
        return [tuple(cell) for cell in self.rng.choice(found, count).tolist()]

    def costs_from(self, start):
        """(H, W) cost of the cheapest path from a cell to each."""
        if self.model is not None:
            return directed_cases.dijkstra(self, self.model, start)
        return oracles.dijkstra(self.cost, start, *self.rule)

    def headings(self):
        """Of a query by their numbers; a body on arcs alone has any."""
        return None, None

    def heading(self, number):
        """In degrees."""
        return None if number is None else heading_deg(number, self.sides)

    def optimum(self, start, goal, begin=None, end=None):
        """Cost of the cheapest path; inf where there is none."""
        stand = self.passable[start] and self.passable[goal]
        return float(self.costs_from(start)[goal]) if stand else math.inf

    def path_cost(self, path):
        """Sum of a path's steps; inf where it cannot be walked."""
        if oracles.path_problem(path, self.cost, path[0], path[-1], self.corner_cutting):
            return math.inf
        if self.model is not None:
            return directed_cases.path_cost(path, self, self.model)
        return oracles.path_cost(path, self.cost, self.step_cost, self.omega)

    def near(self, cost):
        """By how much a cost may be off."""
        slack = 1e-6 if self.model is None else directed_cases.tolerance(self, self.model)
        return 2e-5 * abs(cost) + slack

    def judge(self, plan, optimum, epsilon=math.inf):
        """Assert that a plan is right where the cheapest path costs so much, and its own costs at
        most a share more.
        """
        assert plan.ok == math.isfinite(optimum), (plan, optimum)
        if plan.ok:
            near = self.near(optimum)
            cost = self.path_cost(plan.walked)
            assert abs(plan.cost - cost) <= self.near(cost), (plan, cost)
            ready = 0.0  # by what a body that is on its path has it cheaper: the gear is in already
            if getattr(plan, "source", None) == "standing" and self.vehicle:
                ready = self.vehicle.gear_change_m / self.sides[0]
            assert plan.lower_bound - near <= optimum <= cost + ready + near, (plan, optimum)
            most = optimum + near + epsilon * (abs(optimum) + near)
            assert cost <= most, (plan, optimum)


class BodyWorld(World):
    """A body, by its motions: those of the ground, or any that pass at random."""

    def __init__(self, rng, vehicle, *, step_cost="paper", any_motions=False):
        self.any_motions = any_motions
        self.seed = int(rng.integers(1 << 30))
        dem, sides = self.heights(rng, vehicle)
        layers = dem, np.zeros(dem.shape, np.float32)
        super().__init__(rng, layers, sides, step_cost=step_cost, vehicle=vehicle)

    def heights(self, rng, vehicle):
        """Of cells, and their sides."""
        width = float(rng.choice((0.25, 0.2)))
        if not self.any_motions:
            return pose_oracles.rocks(self.seed % 97, 40, 42, 0.01), (0.25, 0.25)
        shape = (17, 21) if vehicle.reverse_cost or not vehicle.turning_radius_m else (31, 35)
        return np.zeros(shape, np.float32), (0.25, width)

    def planner(self, *towards, **options):
        """As of every world."""
        made = super().planner(*towards, **options)
        if self.any_motions:
            scrambled(made, self.seed)
        return made

    def read(self):
        """Read what motions cost now."""
        made = self.planner()
        self.grid = made.state.grid
        poses = bodies.poses_of(made)
        self.passable = (poses.standing() < FAILS).any(0)
        self.codes = poses.codes.reshape(self.dem.shape[0] + 2, self.dem.shape[1] + 2, -1)
        self.codes = self.codes[1:-1, 1:-1]
        self.motions = bodies.priced(made, self.omega)
        if self.model is not None:
            self.by_slope(self.motions, self.dem.astype(float))
        self.graph = self.made_graph()

    def made_graph(self):
        """The ways between its states."""
        return pose_oracles.graph_of_states(self.motions)

    def by_slope(self, motions, heights):
        """Price motions that pass by the slope, but for what the height between the ends is
        worth.
        """
        for k, step in enumerate(DIRECTIONS):
            here, there = pose_oracles.between(heights.shape, step)
            rises = heights[there] - heights[here]
            length = math.hypot(*np.multiply(step, self.sides))
            ways = self.model.cost(length, rises) - self.model.height_price * rises
            legs = motions.legs[(*here, k)]
            legs[:] = np.where(legs < np.inf, ways, np.inf)
        motions.turns[:] *= self.sides[0] * float(self.model.cost(1.0, 0.0))

    def worth(self, start, goal):
        """What the height between two cells is worth; (H, W) of all goals with a slice."""
        price = 0.0 if self.model is None else self.model.height_price
        heights = np.nan_to_num(self.dem.astype(float))
        return price * (heights[goal] - heights[start])

    def costs_from(self, start):
        """As of every world."""
        found = pose_oracles.costs_to_cells(self.motions, start, self.graph)
        return found + self.worth(start, ...)

    def path_cost(self, path):
        """As of every world."""
        if len(path) == 1 and not self.passable[tuple(path[-1])]:
            return math.inf
        cost = pose_oracles.path_cost(self.motions, path.tolist())
        return cost + self.worth(tuple(path[0]), tuple(path[-1]))


class ArcWorld(BodyWorld):
    """A body that drives arcs, from any heading to any, or from and to given ones."""

    def headings(self):
        """Of a query by their numbers; None for any."""
        return tuple(self.rng.choice((*range(16), *[None] * 16), 2))

    def optimum(self, start, goal, begin=None, end=None):
        """As of every world, between headings by their numbers."""
        costs = self.costs_to_arcs(start, begin)
        return float(costs[goal][slice(None) if end is None else end].min())

    def costs_from(self, start):
        """As of every world."""
        return self.costs_to_arcs(start, None).min((2, 3))

    def costs_to_arcs(self, start, begin):
        """(H, W, 16, 3) cost of the cheapest path from a cell and heading to each state."""
        begins = [(begin, 1)] if begin is not None else itertools.product(range(16), (1, -1))
        starts = [(*start, *each) for each in begins]
        return oracles.costs_from(self.graph, (*self.dem.shape, 16, 3), *starts)

    def made_graph(self):
        """As of every body."""
        scale = 255.0 * self.omega
        return pose_oracles.graph_of_arcs(self.codes, self.vehicle, self.sides, scale)

    def path_cost(self, path):
        """By the searches' own sum: how its pieces lie is tested with arcs."""
        costs = np.zeros(len(path))
        return costs[-1] if self.grid.walk(path, 0, costs) < 0 else math.inf


def same_maps(one, other):
    """Cells, coarse levels and a body's motions weigh the same for two planners."""
    pyramids = [each.state.pyramid for each in (one, other)]
    for each in (one, other):
        each.state.grid.complete()
    np.testing.assert_array_equal(one.state.grid.map(), other.state.grid.map())
    poses = [each.state.grid.robot.moves.poses for each in (one, other)]
    # heights are kept relative to the first that was known, which may have changed
    if None not in poses and np.array_equal(*(each.heights for each in poses), equal_nan=True):
        np.testing.assert_array_equal(*(each.codes for each in poses))
    if one.state.grid.model.kind == "length":  # walls weigh by the dearest cell that there ever was
        return
    for ours, theirs in zip(*(each.levels[1:] for each in pyramids), strict=True):
        np.testing.assert_allclose(ours.grid.weights, theirs.grid.weights, rtol=1e-6)
        np.testing.assert_array_equal(ours.pieces, theirs.pieces)
        np.testing.assert_array_equal(ours.links, theirs.links)
        prices = [each.grid.robot.price for each in (ours, theirs)]
        if prices[0].directed:
            np.testing.assert_allclose(*(each.edges() for each in prices), rtol=1e-5)
            np.testing.assert_allclose(*(each.edges(True) for each in prices), rtol=1e-5)


def on_costs(rng, step_cost="paper", vehicle=None):
    """A point, or a disc, on random costs."""
    shape = tuple(rng.integers(1, rng.choice((24, 60)), 2))
    costs = random_costs(rng, shape, step_cost, rng.choice(KINDS), rng.choice((0.0, 0.15, 0.4)))
    return World(rng, (None, costs), (0.5, 0.5), step_cost=step_cost, vehicle=vehicle)


def on_heights(rng, step_cost="paper", vehicle=None, kind=World):
    """A point, or a disc, on slopes, ridges, steps and holes."""
    dem, sides, limits = directed_cases.hills(rng, int(rng.choice((24, 24, 24, 64))))
    layers = dem, np.zeros(dem.shape, np.float32)
    return kind(rng, layers, sides, limits, step_cost=step_cost, vehicle=vehicle)


def with_body(rng, step_cost="paper", *, any_motions=False):
    """A body that turns on the spot."""
    vehicle = replace(ROVER, turn_cost_m_per_rad=rng.choice((0.0, None, 5.0)))
    return BodyWorld(rng, vehicle, step_cost=step_cost, any_motions=any_motions)


def on_arcs(rng, *, any_motions=False):
    """One that drives arcs."""
    return ArcWorld(rng, CARS[rng.integers(len(CARS))], any_motions=any_motions)


DISC = Vehicle(radius_m=0.7)
WORLDS = {
    "costs": on_costs,
    "lengths": partial(on_costs, step_cost="length"),
    "disc": partial(on_costs, vehicle=DISC),
    "heights": on_heights,
    "disc on heights": partial(on_heights, vehicle=DISC),
    "disc by slope": partial(on_heights, step_cost="tobler", vehicle=DISC),
    **{name: partial(on_heights, step_cost=name) for name in MODELS},
    "body": with_body,
    "body by slope": partial(with_body, step_cost="tobler"),
    "body by energy": partial(with_body, step_cost="energy"),
    "arcs": on_arcs,
}
"""Robots and maps, each made from random numbers."""
ANY_MOTIONS = {
    "any legs": partial(with_body, any_motions=True),
    "any arcs": partial(on_arcs, any_motions=True),
}
"""Bodies of which any motions pass, which no ground allows."""
