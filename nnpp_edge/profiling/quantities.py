"""Subjects of budgets: the quantities of a profile, their units, and what makes them uncertain."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """A figure of a planner at one workload and size, or of the machine."""

    unit: str
    meaning: str
    basis: str = ""
    """Of which medians the two halves of a run must agree: ``time``, ``inference``, ``map``, ``patch``, ``reaction``,
    ``ratio`` (exact A*'s time over the planner's) or ``int8_ratio``. Empty where noise changes nothing."""
    scale: float = 1.0
    """From the figure in a report to the unit of budgets: shares are kept as such, budgets are set in percent."""
    whole_run: bool = False
    """There is one figure for the run, not one for each workload and size."""
    of_loop: bool = False
    """It is a figure of the onboard loop, not of a planner."""


QUANTITIES: dict[str, Quantity] = {
    "fps": Quantity("1/s", "plans a second: 1000 over the median time in ms", "time"),
    "time_ms_median": Quantity("ms", "median time of a plan", "time"),
    "time_ms_p90": Quantity("ms", "time that 90 % of the queries stay below", "time"),
    "time_ms_p99": Quantity("ms", "time that 99 % of the queries stay below", "time"),
    "time_ms_max": Quantity("ms", "time of the slowest query", "time"),
    "inference_fps": Quantity(
        "1/s", "runs of the whole network, on map and query, a second, by its median time", "inference"
    ),
    "inference_ms_median": Quantity("ms", "median time of the whole network on a map and a query", "inference"),
    "map_ms": Quantity("ms", "median time from elevations to the first path on a map that has just arrived", "map"),
    "map_ms_p99": Quantity("ms", "the time that 99 % of such maps stay below", "map"),
    "patch_ms": Quantity("ms", "median time of a patch of elevations into all that the next plan reads", "patch"),
    "patch_ms_p99": Quantity("ms", "the time that 99 % of the patches stay below", "patch"),
    "reaction_ms": Quantity(
        "ms", "median time in the loop from a patch's arrival to the path being published", "reaction", of_loop=True
    ),
    "reaction_ms_p99": Quantity("ms", "the time that 99 % of the reactions stay below", "reaction", of_loop=True),
    "speedup_median": Quantity("x", "median over queries of exact A*'s time over the planner's", "ratio"),
    "speedup_total": Quantity("x", "exact A*'s summed time over the planner's", "ratio"),
    "int8_speedup": Quantity("x", "the fp32 network's median time over the int8 network's", "int8_ratio"),
    "gap_mean": Quantity("%", "mean of path cost over the optimum, less 1", scale=100.0),
    "gap_p99": Quantity("%", "gap that 99 % of the queries stay below", scale=100.0),
    "gap_max": Quantity("%", "largest gap", scale=100.0),
    "cc_excess": Quantity("%", "summed CC (Σ T along the path) over that of the optimal paths, less 1", scale=100.0),
    "success_first": Quantity("%", "queries answered by the first region, before any widening", scale=100.0),
    "success": Quantity("%", "queries answered, widening and whole-map search included", scale=100.0),
    "expansions_median": Quantity("1", "cells expanded for a query, at all levels"),
    "energy_mj": Quantity("mJ", "energy of the processor package for a plan, where the machine counts it", "time"),
    "peak_memory_mb": Quantity("MB", "peak memory of a process that plans once on the largest map", whole_run=True),
    "start_up_warm_s": Quantity(
        "s", "import to first plan in a new process, kernels compiled", "time", whole_run=True
    ),
    "start_up_cold_s": Quantity("s", "the same, kernels compiled on the way", "time", whole_run=True),
    "model_mb": Quantity("MB", "size of the model's file", whole_run=True),
}
BASIS_UNITS = {
    "time": "ms",
    "inference": "ms",
    "map": "ms",
    "patch": "ms",
    "reaction": "ms",
    "ratio": "x",
    "int8_ratio": "x",
}
LOOP = "loop"
"""Whom figures of the onboard loop belong to, in place of a planner."""
DIRECTIONS = ("at least", "at most")
STAGES = ("encode", "inference", "threshold", "coarse", "search", "path", "other")
"""Of a plan, in the order of work."""
