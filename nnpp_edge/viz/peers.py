"""The picture of `nnpp-edge profile --peers`: time of a query against the map's size."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict

from nnpp_edge.files import write_whole

OURS = ("astar", "corridor", "nnpp")


class SizeTime(TypedDict):
    """Of a row of the comparison, what the picture shows."""

    planner: str
    size: int
    time_ms_median: float | None


def times_by_size(rows: Sequence[SizeTime], path: Path) -> None:
    """Median time of a query of each planner against the side of the map, both axes logarithmic."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5.5), layout="constrained")
    axes = figure.add_subplot()
    for name in dict.fromkeys(row["planner"] for row in rows):
        measured = [row for row in rows if row["planner"] == name and row["time_ms_median"] is not None]
        if measured:
            times = [row["time_ms_median"] or 0.0 for row in measured]
            line, width = ("o-", 2.2) if name in OURS else ("s--", 1.2)
            axes.plot([row["size"] for row in measured], times, line, linewidth=width, label=name)
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    sides = sorted({row["size"] for row in rows})
    axes.set_xticks(sides, [str(side) for side in sides])
    axes.minorticks_off()
    axes.set_xlabel("side of the map, cells")
    axes.set_ylabel("median time of a query, ms")
    axes.grid(alpha=0.3)
    axes.legend()
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=110)
    write_whole(path, content.getvalue())
