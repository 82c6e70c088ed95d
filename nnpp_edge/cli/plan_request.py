"""What `nnpp-edge plan` is asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import click

if TYPE_CHECKING:
    from pathlib import Path

    from nnpp_edge.cli.ends import End
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.terrain.georeference import Place


class Ends(NamedTuple):
    """Cells of the map that a path is to lead from, through and to."""

    start: Cell
    via: list[Cell]
    goals: list[Cell]


@dataclass(frozen=True)
class Request:
    """What is to be planned, and how. The options' values, as given."""

    start: End
    goals: tuple[End, ...]
    via: tuple[End, ...]
    best_order: bool
    method: str
    model: str
    omega: float
    corner_cutting: bool
    epsilon: float | None
    time_limit: float | None
    landmarks: int
    compare: bool
    step_cost: str
    refine: str | None = None

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        if self.best_order and not self.via:
            raise click.UsageError("--best-order is of way points: give --via too")
        if self.via and self.compare:
            raise click.UsageError("--compare is of one leg: leave out --via")

    @property
    def files(self) -> list[Path]:
        """Vector files that are read."""
        return [end.file for end in (self.start, *self.via, *self.goals) if end.file is not None]

    def ends(self, dem: Place) -> Ends:
        """Start, way points and goals as cells; InvalidQueryError for several starts, or goals with way points."""
        starts = self.start.cells(dem)
        goals = [cell for end in self.goals for cell in end.cells(dem)]
        via = [cell for end in self.via for cell in end.cells(dem)]
        for name, cells, wanted in (("--start", starts, True), ("--goal, with --via,", goals, bool(self.via))):
            if wanted and len(cells) != 1:
                from nnpp_edge.runtime.errors import InvalidQueryError

                raise InvalidQueryError(f"{name} must be one place, got {len(cells)}")
        return Ends(starts[0], via, goals)

    def expects_network(self, dem: Place, ends: Ends) -> bool:
        """Whether ``auto`` is expected to ask the network for one of the goals."""
        from nnpp_edge.runtime.planners.choice import expects_network
        from nnpp_edge.runtime.planners.query import Query

        ways = (Query(ends.start, goal).apart for goal in ends.goals)
        return any(expects_network(self.method, dem.shape, self.model, apart) for apart in ways)
