"""What `nnpp-edge plan` is asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.terrain.georeference import Place


@dataclass(frozen=True)
class Request:
    """What is to be planned, and how. The options' values, as given."""

    start: Cell | None
    goals: tuple[Cell, ...]
    start_xy: tuple[float, ...] | None
    goals_xy: tuple[tuple[float, ...], ...]
    method: str
    model: str
    omega: float
    corner_cutting: bool
    epsilon: float | None
    time_limit: float | None
    landmarks: int
    compare: bool
    price: str | None
    step_cost: str
    refine: str | None = None

    def __post_init__(self) -> None:
        """Refuse a start or goals that are missing, or given as cells and as coordinates."""
        start_xy = (self.start_xy,) if self.start_xy else ()
        for name, cells, places in (("start", self.start, start_xy), ("goal", self.goals, self.goals_xy)):
            if bool(cells) == bool(places):
                raise click.UsageError(f"give either --{name} ROW,COL or --{name}-xy X,Y")
            if any(len(place) != 2 for place in places):
                raise click.UsageError(f"--{name}-xy must be two numbers X,Y")

    def cells(self, dem: Place) -> tuple[Cell, list[Cell]]:
        """Start and goals as cells of the map."""
        start = self.start or dem.cell_of(*(self.start_xy or ()))
        return start, [*self.goals, *(dem.cell_of(*place) for place in self.goals_xy)]

    def expects_network(self, dem: Place) -> bool:
        """Whether ``auto`` is expected to ask the network for one of the goals."""
        from nnpp_edge.runtime.planners.choice import expects_network
        from nnpp_edge.runtime.planners.query import Query

        start, goals = self.cells(dem)
        ways = (Query(start, goal).apart for goal in goals)
        return any(expects_network(self.method, dem.shape, self.model, apart) for apart in ways)
