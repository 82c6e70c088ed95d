"""What `nnpp-edge costmap` says of a cost map."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nnpp_edge.terrain.georeference import Place

SHARES = (0.1, 0.5, 0.9, 0.99)
"""Of the passable cells, whose greatest cost is told."""


@dataclass(frozen=True)
class MapSize:
    """Cells of a map, and their sides in metres."""

    rows: int
    cols: int
    cell_size_m: float
    cell_width_m: float

    @classmethod
    def of(cls, dem: Place) -> MapSize:
        """Size of an elevation map."""
        return cls(*dem.shape, dem.cell_size_m, dem.cell_width_m)

    def __str__(self) -> str:
        size, width = self.cell_size_m, self.cell_width_m
        square = abs(size - width) <= 5e-4 * size
        cell = f"{size:.4g} m" if square else f"{size:.4g} m (north) × {width:.4g} m (east)"
        return f"{self.rows} × {self.cols} cells of {cell}"


@dataclass(frozen=True)
class CostSummary:
    """What a cost map holds."""

    size: MapSize
    passable_share: float
    """Share of the cells that are passable."""
    cost_quantiles: dict[str, float | None]
    """Cost that a share of the passable cells does not pass, by that share."""
    saturated_share: dict[str, float]
    """Share of the cells of known height at which a term is at its limit, by the term."""

    def figures(self) -> dict[str, object]:
        """Ready for JSON."""
        return {**asdict(self.size), **{key: value for key, value in vars(self).items() if key != "size"}}

    def text(self, dem: Path, files: list[str]) -> str:
        """For people."""
        shares = ((100 * float(share), cost) for share, cost in self.cost_quantiles.items() if cost is not None)
        costs = ", ".join(f"{share:.0f} % of cells up to {cost:.3f}" for share, cost in shares)
        at_limit = ", ".join(f"{term} {100 * share:.1f} %" for term, share in self.saturated_share.items())
        lines = (
            f"map       {dem.name}: {self.size}",
            f"passable  {100 * self.passable_share:.2f} % of cells",
            f"cost      {costs or 'no cell is passable'}",
            f"at limit  {at_limit}",
            f"written   {', '.join(files)}",
        )
        return "\n".join(lines)
