"""The quantities that budgets are set on: the unit of each, and how it becomes a figure of a run's
rows. docs/reference/figures.md says what they are.
"""

from collections.abc import Callable
from functools import partial
from operator import methodcaller
from typing import NamedTuple

from nnpp_edge.profiling.rows import Rows

EXACT = "astar"
"""The rival that all others are compared with."""
Figure = Callable[[Rows], float | None]
"""None where nothing was measured."""


class Quantity(NamedTuple):
    """A figure that budgets are set on, of a planner at one workload and size."""

    unit: str
    basis: str
    """Of what the two halves of a run must agree: of `BASES`, or ``reaction``. Empty where noise
    changes nothing.
    """
    figure: Figure | None
    """Of a planner's rows. None for what a report has as part of a spread, and of the whole run."""
    whole_run: bool
    """There is one figure for the run, not one for each workload and size."""
    of_loop: bool
    """It is a figure of the onboard loop, not of a planner."""

    @property
    def scale(self) -> float:
        """From the figure in a report to the unit of budgets: shares are kept as such, budgets are
        set in percent.
        """
        return 100.0 if self.unit == "%" else 1.0


def _rate(column: str, rows: Rows) -> float | None:
    """How many a second, by the median."""
    median_ms = rows.figure(f"{column}_median")
    return None if median_ms is None else 1e3 / median_ms


def _int8_speedup(rows: Rows) -> float | None:
    fp32_ms = rows.figure("fp32_ms_median")
    int8_ms = rows.figure("inference_ms_median")
    return None if fp32_ms is None or int8_ms is None else fp32_ms / int8_ms


_FIGURES: dict[str, Figure] = {
    "fps": partial(_rate, "time_ms"),
    "inference_fps": partial(_rate, "inference_ms"),
    "map_fps": partial(_rate, "map_ms"),
    "speedup_total": methodcaller("ratio", "exact_ms", "time_ms"),
    "speedup_map": methodcaller("ratio", "exact_map_ms", "map_ms"),
    "speedup_plain": methodcaller("ratio", "plain_ms", "time_ms"),
    "int8_speedup": _int8_speedup,
    "cc_excess": methodcaller("increase"),
    "success_first": methodcaller("figure", "found_mean"),
    "success": methodcaller("figure", "solved_mean"),
}
"""Of the quantities that are called otherwise than `Rows.figure` calls them."""
BASES: dict[str, Figure] = {
    "time": methodcaller("figure", "time_ms_median"),
    "map": methodcaller("figure", "map_ms_median"),
    "patch": methodcaller("figure", "patch_ms_median"),
    "inference": methodcaller("figure", "inference_ms_median"),
    "ratio": methodcaller("figure", "speedup_median"),
    "map_ratio": _FIGURES["speedup_map"],
    "plain_ratio": _FIGURES["speedup_plain"],
    "int8_ratio": _int8_speedup,
}
"""Figures that the halves of a run must agree in: ``ratio`` of exact A*'s time to the planner's,
``map_ratio`` the same on maps that have just arrived, ``plain_ratio`` of that of an A* in plain
Python, ``int8_ratio`` of the fp32 network's to the int8 network's.
"""
_TABLE = """
fps                 | 1/s | time        | row
time_ms_median      | ms  | time        | spread
time_ms_p90         | ms  | time        | spread
time_ms_p99         | ms  | time        | spread
time_ms_max         | ms  | time        | spread
inference_fps       | 1/s | inference   | row
inference_ms_median | ms  | inference   | row
map_fps             | 1/s | map         | row
map_ms              | ms  | map         | spread
map_ms_p99          | ms  | map         | spread
patch_ms            | ms  | patch       | spread
patch_ms_p99        | ms  | patch       | spread
reaction_ms         | ms  | reaction    | spread, loop
reaction_ms_p99     | ms  | reaction    | spread, loop
reaction_ms_p999    | ms  | reaction    | spread, loop
late_per_hour       | 1/h | reaction    | loop
speedup_median      | x   | ratio       | row
speedup_total       | x   | ratio       | row
speedup_map         | x   | map_ratio   | row
speedup_plain       | x   | plain_ratio | row
int8_speedup        | x   | int8_ratio  | row
gap_mean            | %   |             | row
gap_p99             | %   |             | row
gap_max             | %   |             | row
cc_excess           | %   |             | row
success_first       | %   |             | row
success             | %   |             | row
expansions_median   | 1   |             | row
peak_memory_mb      | MB  |             | run
start_up_warm_s     | s   | time        | run
first_tick_warm_s   | s   | time        | run, loop
model_mb            | MB  |             | run
"""
"""Name, unit, basis; and whether there is one figure for a planner's row of results, a part of a
spread there, or one for the whole run; and whether it is the loop's.
"""


def _quantity(name: str, unit: str, basis: str, kind: str) -> Quantity:
    figure = _FIGURES.get(name, methodcaller("figure", name)) if kind == "row" else None
    return Quantity(unit, basis, figure, kind.startswith("run"), kind.endswith("loop"))


_LINES = [[cell.strip() for cell in line.split("|")] for line in _TABLE.strip().splitlines()]
QUANTITIES = {cells[0]: _quantity(*cells) for cells in _LINES}
THOUSANDTH = 1000
"""Fewer samples have no slowest thousandth."""
STARTS = ("start_up_warm_s", "first_tick_warm_s")
