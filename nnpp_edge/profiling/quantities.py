"""The quantities that budgets are set on: the unit of each, and how it becomes a figure of a run's
rows. docs/reference/figures.md says what they are.
"""

from collections.abc import Callable
from functools import partial
from operator import methodcaller
from typing import NamedTuple

from nnpp_edge.profiling.rows import Rows

Figure = Callable[[Rows], float | None]
"""None where nothing was measured."""


def _named(name: str) -> Figure:
    """A column and its reduction, see `Rows.figure`."""
    return methodcaller("figure", name)


def _rate(column: str, rows: Rows) -> float | None:
    """How many a second, by the median."""
    median_ms = rows.figure(f"{column}_median")
    return None if median_ms is None else 1e3 / median_ms


def _int8_speedup(rows: Rows) -> float | None:
    fp32_ms = rows.figure("fp32_ms_median")
    int8_ms = rows.figure("inference_ms_median")
    return None if fp32_ms is None or int8_ms is None else fp32_ms / int8_ms


class Quantity(NamedTuple):
    """A figure that budgets are set on, of a planner at one workload and size."""

    unit: str
    basis: str = ""
    """Of what the two halves of a run must agree: of `BASES`, or ``reaction``. Empty where noise
    changes nothing.
    """
    figure: Figure | None = None
    """Of a planner's rows. None for what a report has as part of a spread, and of the whole run."""
    scale: float = 1.0
    """From the figure in a report to the unit of budgets: shares are kept as such, budgets are set
    in percent.
    """
    whole_run: bool = False
    """There is one figure for the run, not one for each workload and size."""
    of_loop: bool = False
    """It is a figure of the onboard loop, not of a planner."""


BASES: dict[str, Figure] = {
    "time": _named("time_ms_median"),
    "map": _named("map_ms_median"),
    "patch": _named("patch_ms_median"),
    "inference": _named("inference_ms_median"),
    "ratio": _named("speedup_median"),
    "plain_ratio": methodcaller("ratio", "plain_ms", "time_ms"),
    "int8_ratio": _int8_speedup,
}
"""Figures that the halves of a run must agree in: ``ratio`` of exact A*'s time to the planner's,
``plain_ratio`` of that of an A* in plain Python, ``int8_ratio`` of the fp32 network's to the int8
network's.
"""
_SHARES: dict[str, Figure] = {
    **{name: _named(name) for name in ("gap_mean", "gap_p99", "gap_max")},
    "cc_excess": methodcaller("increase"),
    "success_first": _named("first_mean"),
    "success": _named("solved_mean"),
}
_WHOLE_RUN = Quantity("MB", whole_run=True)
_START = Quantity("s", "time", whole_run=True)
QUANTITIES = {
    "fps": Quantity("1/s", "time", partial(_rate, "time_ms")),
    **{f"time_ms_{which}": Quantity("ms", "time") for which in ("median", "p90", "p99", "max")},
    "inference_fps": Quantity("1/s", "inference", partial(_rate, "inference_ms")),
    "inference_ms_median": Quantity("ms", "inference", _named("inference_ms_median")),
    "map_fps": Quantity("1/s", "map", partial(_rate, "map_ms")),
    **dict.fromkeys(("map_ms", "map_ms_p99"), Quantity("ms", "map")),
    **dict.fromkeys(("patch_ms", "patch_ms_p99"), Quantity("ms", "patch")),
    **dict.fromkeys(
        ("reaction_ms", "reaction_ms_p99", "reaction_ms_p999"),
        Quantity("ms", "reaction", of_loop=True),
    ),
    "late_per_hour": Quantity("1/h", "reaction", of_loop=True),
    "speedup_median": Quantity("x", "ratio", _named("speedup_median")),
    "speedup_total": Quantity("x", "ratio", methodcaller("ratio", "exact_ms", "time_ms")),
    "speedup_plain": Quantity("x", "plain_ratio", BASES["plain_ratio"]),
    "int8_speedup": Quantity("x", "int8_ratio", _int8_speedup),
    **{name: Quantity("%", "", figure, 100.0) for name, figure in _SHARES.items()},
    "expansions_median": Quantity("1", "", _named("expansions_median")),
    "energy_mj": Quantity("mJ", "time", _named("energy_mj_mean")),
    "peak_memory_mb": _WHOLE_RUN,
    **dict.fromkeys(("start_up_warm_s", "start_up_cold_s"), _START),
    **dict.fromkeys(("start_up_warm_mb", "start_up_cold_mb"), _WHOLE_RUN),
    **dict.fromkeys(("first_tick_warm_s", "first_tick_cold_s"), _START._replace(of_loop=True)),
    **dict.fromkeys(
        ("first_tick_warm_mb", "first_tick_cold_mb"), _WHOLE_RUN._replace(of_loop=True)
    ),
    "prior_ms": Quantity("ms", "time", whole_run=True, of_loop=True),
    "model_mb": _WHOLE_RUN,
}
THOUSANDTH = 1000
"""Fewer samples have no slowest thousandth."""
STARTS = tuple(name for name in QUANTITIES if name.startswith(("start_up", "first_tick")))
