"""A run's figures: what each planner did at each workload and size, as rows of a report, and who
pays over whom.
"""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from nnpp_edge.profiling.arrivals import patch_side
from nnpp_edge.profiling.contest import (
    Columns,
    Facts,
    Summary,
    answer,
    mean,
    quantile,
    ratio,
    summarised,
)
from nnpp_edge.profiling.measure import HALVES, Answers, Measurements, WorkloadRun
from nnpp_edge.profiling.profile_file import THOUSANDTH
from nnpp_edge.profiling.rivals import EXACT
from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.loop.settings import OnboardLoop

STAGES = ("encode", "inference", "threshold", "coarse", "search", "path", "other")
"""Of a plan, in the order of work."""
PAIRS = (("corridor", "astar"), ("nnpp", "astar"), ("nnpp", "corridor"))
"""Who might pay over whom."""


def _cc_excess(columns: Columns) -> float | None:
    share = ratio("cc", "exact_cc")(columns)
    return None if share is None else share - 1.0


_ANSWERS: Summary = {
    "n": lambda columns: len(columns["time_ms"]),
    "speedup_median": quantile("speedup", 0.5),
    "speedup_total": ratio("exact_ms", "time_ms"),
    "gap_mean": mean("gap"),
    "gap_p99": quantile("gap", 0.99),
    "gap_max": quantile("gap", 1.0),
    "cc_excess": _cc_excess,
    "success_first": mean("first"),
    "success": mean("solved"),
    "expansions_median": quantile("expansions", 0.5),
}


def rows(run: Measurements) -> list[Facts]:
    """A row for each workload, size and planner, in order: ``results`` in
    docs/reference/figures.md.
    """
    return [_row(of, name) for of in run.workloads for name in of.answers]


def stages_of(results: Sequence[Facts]) -> list[str]:
    """The stages of all rows, in the order of work."""
    found = {stage for row in results for stage in row["stages_ms"]}
    return [*(stage for stage in STAGES if stage in found), *sorted(found - set(STAGES))]


def loop_rows(run: Measurements, loop: OnboardLoop) -> list[Facts]:
    """A row for each workload and size at which the reactions of this loop were measured."""
    found: list[Facts] = []
    for of in run.workloads:
        if not of.reactions:
            continue
        halves = [np.array(each.ms) for each in of.reactions]
        counted = ("planned", "kept", "without_path", "late")
        ms = np.concatenate(halves)
        reaction_ms = _spread(ms)
        if len(ms) >= THOUSANDTH:
            reaction_ms["p999"] = round(float(np.quantile(ms, 0.999)), 6)
        late = sum(each.late for each in of.reactions)
        found.append(
            {
                "workload": of.workload,
                "size": of.size,
                "method": loop.method,
                "rate_hz": loop.rate_hz,
                "patch_side": patch_side((of.size, of.size)),
                "n": len(ms),
                "reaction_ms": reaction_ms,
                "late_per_hour": 3600.0 * late * loop.rate_hz / len(ms),
                **{key: sum(getattr(each, key) for each in of.reactions) for key in counted},
                "halves": {"reaction": [_median(half) for half in halves]},
            }
        )
    return found


def break_even(results: Sequence[Facts]) -> list[Facts]:
    """The size from which on one planner pays over another, of each pair; None where it does not at
    the largest.
    """
    totals: dict[str, dict[int, float]] = defaultdict(lambda: defaultdict(float))
    for row in results:
        totals[row["planner"]][row["size"]] += row["n"] * row["time_ms"]["mean"]
    lines: list[Facts] = []
    for planner, over in PAIRS:
        size_from = None
        for size in sorted(totals[planner], reverse=True):
            if totals[planner][size] >= totals[over][size]:
                break
            size_from = size
        lines.append({"planner": planner, "over": over, "size_from": size_from})
    return lines


def _row(of: WorkloadRun, name: str) -> Facts:
    answers = of.answers[name]
    exact = of.answers[EXACT]
    times = answers.column("time_ms")
    exact_times = exact.column("time_ms")
    found = []
    for plan, ms, optimum, exact_ms in zip(
        answers.plans, times, exact.plans, exact_times, strict=True
    ):
        of_query = answer(plan, ms, optimum.cost, exact_ms)
        found.append(of_query | {"exact_cc": plan.ok * optimum.traverse_cost})
    energy_mj = float(np.mean(answers.energy_mj))
    whole = _spread(times)
    network_ms = _median(answers.column("network_ms"))
    fp32 = of.answers.get("nnpp-fp32") if name == "nnpp" and network_ms else None
    plain = _plain_ratios(of, times)
    arrivals = {key: answers.column(key) for key in ("map_ms", "patch_ms")}
    return {
        "workload": of.workload,
        "size": of.size,
        "terrain": of.terrain,
        "planner": name,
        "time_ms": whole,
        "fps": 1e3 / whole["median"],
        "stages_ms": _stages(answers),
        **summarised(found, _ANSWERS),
        "energy_mj": None if np.isnan(energy_mj) else energy_mj,
        "inference_ms_median": network_ms or None,
        "inference_fps": 1e3 / network_ms if network_ms else None,
        "int8_speedup": fp32 and _median(fp32.column("network_ms")) / network_ms,
        "speedup_plain": float(np.mean(plain)) if plain else None,
        "map_fps": 1e3 / _median(arrivals["map_ms"]) if len(arrivals["map_ms"]) else None,
        **{key: _spread(ms) if len(ms) else None for key, ms in arrivals.items()},
        "halves": _halves(of, name),
    }


def _halves(of: WorkloadRun, name: str) -> dict[str, list[float]]:
    """For each basis of a budget its median in either half."""

    bases = {"time": "time_ms", "map": "map_ms", "patch": "patch_ms", "inference": "network_ms"}
    columns = {basis: of.answers[name].halves(figure) for basis, figure in bases.items()}
    columns["ratio"] = of.answers[EXACT].halves("time_ms") / columns["time"]
    medians = {basis: np.median(both, axis=1) for basis, both in columns.items() if both.size}
    if plain := _plain_ratios(of, columns["time"]):
        medians["plain_ratio"] = np.array(plain)
    if name == "nnpp" and "inference" in medians and "nnpp-fp32" in of.answers:
        fp32 = np.median(of.answers["nnpp-fp32"].halves("network_ms"), axis=1)
        medians["int8_ratio"] = fp32 / medians["inference"]
    return {basis: both.tolist() for basis, both in medians.items()}


def _plain_ratios(of: WorkloadRun, times: Floats) -> list[float]:
    """For each half, how many times as long an A* in plain Python took for the first queries;
    `times` (2, N), or (N,) of both halves, are the planner's.
    """
    halves = np.broadcast_to(times, (HALVES, times.shape[-1]))
    return [
        sum(plain) / float(own[: len(plain)].sum())
        for plain, own in zip(of.plain_ms, halves, strict=True)
        if plain
    ]


def _median(ms: Floats) -> float:
    """0 where nothing was measured."""
    return float(np.median(ms)) if len(ms) else 0.0


def _spread(times: Floats) -> dict[str, float]:
    shares = {"median": 0.5, "p90": 0.9, "p99": 0.99, "max": 1.0}
    spread = {name: np.quantile(times, share) for name, share in shares.items()}
    spread["mean"] = times.mean()
    return {name: round(float(each), 6) for name, each in spread.items()}


def _stages(answers: Answers) -> dict[str, dict[str, float]]:
    """Each stage's times over the queries of both halves; one that a plan did without
    took it 0 ms.
    """
    stages_ms = answers.stages_ms
    ordered = stages_of([{"stages_ms": stages} for stages in stages_ms])
    return {
        stage: _spread(np.array([stages.get(stage, 0.0) for stages in stages_ms]))
        for stage in ordered
    }
