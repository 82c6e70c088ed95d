"""What a contributor adds by CONTRIBUTING.md, made small: a term of Eq. 1 from a layer, a step cost
that is the same both ways, and a robot that stands otherwise. Their worlds are as those of
`tests.worlds`.
"""

from dataclasses import dataclass, replace
from functools import partial
from operator import methodcaller

import numpy as np

from nnpp_edge.runtime import Mobility, Traversability, Vehicle
from nnpp_edge.runtime.map import ground
from nnpp_edge.runtime.options import KINDS, Kind, Term
from nnpp_edge.runtime.robots.robot import Robot, Stance
from nnpp_edge.runtime.robots.slope import cost
from nnpp_edge.runtime.terrain import traversability, vehicle
from tests import directed_cases
from tests.strategies import put
from tests.worlds import World, on_heights

# --- a term


@dataclass(frozen=True)
class Shaded(Traversability):
    """Limits with those of the layer ``shade``."""

    shade_limit: float = 0.5
    shade_weight: float = 0.0
    hard_shade: float = 0.9


SHADED = Shaded(slope_weight=0.4, shade_weight=0.2)
SHADE = Term("shade", "", "shade_limit", "shade_weight", "hard_shade")
MOST_COST = np.nextafter(np.float32(1.0), np.float32(0.0))


def add_term(monkeypatch):
    """Put the term in place."""
    for module in (ground, traversability):
        monkeypatch.setattr(module, "LAYER_TERMS", (SHADE,))


class ShadedWorld(World):
    """A point on heights, some of whose cells are in the shade."""

    def __init__(self, rng):
        dem, sides, limits = directed_cases.hills(rng)
        self.layers = {"shade": self.drawn(rng, dem.shape)}
        limits = replace(SHADED, hard_slope_deg=limits.hard_slope_deg)
        super().__init__(rng, (dem, np.zeros(dem.shape, np.float32)), sides, limits)

    def drawn(self, rng, shape):
        """Shares of the time, a few of them not known."""
        shade = rng.random(shape).astype(np.float32)
        shade[rng.random(shape) < 0.1] = np.nan
        return shade

    def by_heights(self):
        """As of every world."""
        cost = super().by_heights()
        shade = np.nan_to_num(self.layers["shade"], nan=SHADED.shade_limit)
        share = np.minimum(shade / SHADED.shade_limit, 1.0)
        shaded = np.minimum(cost + SHADED.shade_weight * share, MOST_COST)
        shut = np.isinf(cost) | (shade > SHADED.hard_shade)
        return np.where(shut, np.float32(np.inf), shaded)

    def patch(self):
        """As of every world; some of shade."""
        if self.rng.random() < 0.5:
            return super().patch()
        row, col = (int(self.rng.integers(side)) for side in self.dem.shape)
        room = np.minimum(self.rng.integers(1, 7, 2), np.subtract(self.dem.shape, (row, col)))
        patch = self.drawn(self.rng, tuple(room))
        put(self.layers["shade"], row, col, patch)
        return methodcaller("update", row, col, patch, layer="shade")


# --- a step cost


@dataclass(frozen=True)
class RoughCost(cost.SlopeCost):
    """Metres of even ground as dear as a way over rough ground, the same both ways."""

    unit = ""
    symmetric = True

    def per_m(self, slope):
        return np.full_like(slope, 2.0)

    def ground(self, dem, sides_m):
        _, roughness, _ = traversability.terrain_terms(dem, sides_m[0], cell_width_m=sides_m[1])
        return 1.0 + np.float32(9.0) * roughness


@dataclass(frozen=True)
class RoughMobility(Mobility):
    """With the step cost ``rough``."""

    rough: RoughCost = RoughCost()


def add_step_cost(monkeypatch):
    """Put the step cost in place."""
    monkeypatch.setitem(cost.SLOPE_COSTS, "rough", RoughCost)
    monkeypatch.setattr("tests.worlds.MOBILITY", RoughMobility())


# --- a robot


@dataclass(frozen=True)
class OnLegs(Vehicle):
    """A vehicle on legs."""

    leg_step_m: float | None = 0.3


class LegStance(Stance):
    """Stands on some heights alone."""

    def __init__(self, heights):
        self.heights = heights

    def shut(self, point, part):
        return slips(self.heights.known(part))


def slips(heights):
    """Which heights legs slip on."""
    return np.sin(9.0 * heights) > 0.8


def on_legs(state, vehicle, sides_m):
    """The robot of a vehicle on legs."""
    return Robot(LegStance(state.heights))


def add_robot(monkeypatch):
    """Put the robot in place."""
    kind = Kind("hexapod", "leg_step_m", f"{__name__}:on_legs")
    monkeypatch.setattr(vehicle, "KINDS", (kind, *KINDS))


class LegWorld(World):
    """A robot on legs, on heights."""

    def by_heights(self):
        """As of every world."""
        return np.where(slips(self.dem), np.float32(np.inf), super().by_heights())


DOORS = {
    "shade": (add_term, ShadedWorld),
    "rough": (add_step_cost, partial(on_heights, step_cost="rough")),
    "legs": (add_robot, lambda rng: on_heights(rng, vehicle=OnLegs(), kind=LegWorld)),
}
"""By name how each is put in place, and its world."""
