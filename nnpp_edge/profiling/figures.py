"""A run's figures: what each planner did at each workload and size, as rows of a report, and who
pays over whom.
"""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from nnpp_edge.profiling.arrivals import patch_side
from nnpp_edge.profiling.contest import Facts, Summary, answer, mean, quantile, ratio, summarised
from nnpp_edge.profiling.measure import HALVES, Answers, Run, WorkloadRun
from nnpp_edge.profiling.profile_file import OnboardLoop
from nnpp_edge.profiling.rivals import EXACT
from nnpp_edge.runtime.arrays import Floats

STAGES = ("encode", "inference", "threshold", "coarse", "search", "path", "other")
"""Of a plan, in the order of work."""
PAIRS = (("corridor", "astar"), ("nnpp", "astar"), ("nnpp", "corridor"))
"""Who might pay over whom."""


_ANSWERS: Summary = {
    "n": lambda columns: len(columns["time_ms"]),
    "speedup_median": quantile("speedup", 0.5),
    "speedup_total": ratio("exact_ms", "time_ms"),
    "gap_mean": mean("gap"),
    "gap_p99": quantile("gap", 0.99),
    "gap_max": quantile("gap", 1.0),
    "cc_excess": lambda columns: (
        None if (share := ratio("cc", "exact_cc")(columns)) is None else share - 1.0
    ),
    "success_first": mean("first"),
    "success": mean("solved"),
    "expansions_median": quantile("expansions", 0.5),
}


def rows(run: Run) -> list[Facts]:
    """A row for each workload, size and planner, in order: ``results`` in
    docs/reference/figures.md.
    """
    return [_row(of, name) for of in run.workloads for name in of.answers]


def stages_of(results: Sequence[Facts]) -> list[str]:
    """The stages of all rows, in the order of work."""
    found = {stage for row in results for stage in row["stages_ms"]}
    return [*(stage for stage in STAGES if stage in found), *sorted(found - set(STAGES))]


def find(results: Sequence[Facts], workload: str, size: int, planner: str) -> Facts | None:
    place = (workload, size, planner)
    return next(
        (row for row in results if (row["workload"], row["size"], row["planner"]) == place), None
    )


def loop_rows(run: Run, loop: OnboardLoop) -> list[Facts]:
    """A row for each workload and size at which the reactions of this loop were measured."""
    found: list[Facts] = []
    for of in run.workloads:
        if not of.reactions:
            continue
        halves = [each.ms for each in of.reactions]
        found.append(
            {
                "workload": of.workload,
                "size": of.size,
                "method": loop.method,
                "rate_hz": loop.rate_hz,
                "patch_side": patch_side((of.size, of.size)),
                "n": sum(map(len, halves)),
                "reaction_ms": _spread(np.concatenate(halves)),
                "planned": sum(each.planned for each in of.reactions),
                "kept": sum(each.kept for each in of.reactions),
                "without_path": sum(each.without_path for each in of.reactions),
                "halves": {"reaction": [float(np.median(half)) for half in halves]},
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
    network = answers.column("network_ms")
    network_ms = float(np.median(network)) if len(network) else None
    fp32 = of.answers.get("nnpp-fp32") if name == "nnpp" and network_ms else None
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
        "inference_ms_median": network_ms,
        "inference_fps": network_ms and 1e3 / network_ms,
        "int8_speedup": fp32
        and float(np.median(fp32.column("network_ms"))) / float(np.median(network)),
        **{
            key: _spread(column) if len(column := answers.column(key)) else None
            for key in ("map_ms", "patch_ms")
        },
        "halves": _halves(of, name),
    }


def _halves(of: WorkloadRun, name: str) -> dict[str, list[float]]:
    """For each basis of a budget its median in either half."""

    def halves(of_whom: str, figure: str) -> list[Floats]:
        return [of.answers[of_whom].column(figure, half) for half in range(HALVES)]

    bases = {"time": "time_ms", "map": "map_ms", "patch": "patch_ms", "inference": "network_ms"}
    columns = {basis: halves(name, figure) for basis, figure in bases.items()}
    columns["ratio"] = [
        e / own for e, own in zip(halves(EXACT, "time_ms"), columns["time"], strict=True)
    ]
    found = {
        basis: [float(np.median(half)) for half in both]
        for basis, both in columns.items()
        if len(both[0])
    }
    if name == "nnpp" and "inference" in found and "nnpp-fp32" in of.answers:
        both = zip(halves("nnpp-fp32", "network_ms"), found["inference"], strict=True)
        found["int8_ratio"] = [float(np.median(fp32)) / own for fp32, own in both]
    return found


def _spread(times: Floats) -> dict[str, float]:
    shares = {"median": 0.5, "p90": 0.9, "p99": 0.99, "max": 1.0}
    spread = {name: float(np.quantile(times, share)) for name, share in shares.items()}
    return {name: round(each, 6) for name, each in (spread | {"mean": float(times.mean())}).items()}


def _stages(answers: Answers) -> dict[str, dict[str, float]]:
    """Each stage's times over the queries of both halves; one that a plan did without
    took it 0 ms.
    """
    ordered = stages_of([{"stages_ms": stages} for stages in answers.stages_ms])
    return {
        stage: _spread(np.array([plan.get(stage, 0.0) for plan in answers.stages_ms]))
        for stage in ordered
    }
