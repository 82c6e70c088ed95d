"""What a search is asked for."""

import math
from typing import NamedTuple

from nnpp_edge.runtime.arrays import Bool
from nnpp_edge.runtime.cells import Cell, as_cell
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidQueryError


class Query(NamedTuple):
    """Where from and where to, how good, and until when."""

    start: Cell
    goal: Cell
    epsilon: float = math.inf
    """A path that is certain to cost at most 1 + `epsilon` times the optimum is good enough."""
    deadline: Deadline = NEVER
    """When to give up."""
    direction: int = -1
    """In which a body stands at the start, see `robots.body.motions.LEGS`; -1 where any will
    do.
    """
    wanted: Bool | None = None
    """(16,) directions in which it may arrive; None where any will do."""

    @classmethod
    def of(
        cls,
        start: Cell,
        goal: Cell,
        deadline: Deadline,
        epsilon: float = math.inf,
        direction: int = -1,
        wanted: Bool | None = None,
    ) -> "Query":
        """From what a user gave; InvalidQueryError for what is no cell, or a number below 0."""
        if not epsilon >= 0.0:
            raise InvalidQueryError(f"epsilon must be a number of at least 0, got {epsilon}")
        return cls(
            as_cell(start, "start"), as_cell(goal, "goal"), epsilon, deadline, direction, wanted
        )

    @property
    def apart(self) -> int:
        """Cells between start and goal, as the king moves."""
        rows = abs(self.start[0] - self.goal[0])
        cols = abs(self.start[1] - self.goal[1])
        return max(rows, cols)
