"""Random maps and queries for the property tests."""

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st


@dataclass(frozen=True)
class Case:
    """A map in one of the two step-cost models, and two passable cells."""

    cost: np.ndarray
    start: tuple[int, int]
    goal: tuple[int, int]
    step_cost: str
    corner_cutting: bool

    def __repr__(self) -> str:
        """Short enough for hypothesis to print."""
        return f"Case({self.cost.tolist()}, {self.start}, {self.goal}, {self.step_cost}, {self.corner_cutting})"


@st.composite
def cases(draw, most_side: int = 24, any_size: bool = True):
    """Maps of every shape, 1×1 and 1×N among them: smooth, ragged, alike, with weights up to 1e6 or of any size."""
    rows, cols = draw(st.integers(1, most_side)), draw(st.integers(1, most_side))
    step_cost = draw(st.sampled_from(["paper", "length"]))
    kind = draw(st.sampled_from(["uniform", "equal", "levels", "steep", *["any"] * any_size]))
    blocked = draw(st.sampled_from([0.0, 0.15, 0.4, 0.7]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    cost = rng.random((rows, cols))
    if kind == "equal":
        cost[:] = cost[0, 0]
    elif kind == "levels":
        cost = np.round(cost * 3) / 4
    elif kind == "steep" and step_cost == "length":
        cost = 10.0 ** (6.0 * cost)
    elif kind == "any" and step_cost == "length":
        cost = 10.0 ** (67.0 * cost - 37.5)
    if step_cost == "length" and kind != "any":
        cost = cost + 0.01
    cost = cost.astype(np.float32)
    cost[rng.random((rows, cols)) < blocked] = draw(st.sampled_from([np.inf, np.nan]))
    if not np.isfinite(cost).any():
        cost[0, 0] = 0.5
    passable = np.argwhere(np.isfinite(cost))
    start, goal = (tuple(int(x) for x in passable[rng.integers(len(passable))]) for _ in range(2))
    return Case(cost, start, goal, step_cost, draw(st.booleans()))
