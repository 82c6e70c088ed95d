"""A run's figures: what each planner did at each workload and size, as rows of a report."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.measure import EXACT, HALVES, Answers, Block, Run
from nnpp_edge.profiling.quantities import STAGES
from nnpp_edge.runtime.planners.plan import Source

_FIRST = (None, Source.MAP, Source.REGION)
Times = NDArray[np.float64]


def rows(run: Run) -> list[dict[str, Any]]:
    """A row for each workload, size and planner, in order: the ``results`` of docs/profile.md."""
    return [_row(block, name, run.energy_problem) for block in run.blocks for name in block.answers]


def _row(block: Block, name: str, energy_problem: str) -> dict[str, Any]:
    answers, exact = block.answers[name], block.answers[EXACT]
    judged = np.array([question.judged for question in block.questions])
    times, exact_times = answers.times(), exact.times()
    gaps = np.array(answers.cost) / np.array(exact.cost) - 1.0
    solved = np.array(answers.solved)
    kept = judged & solved
    row: dict[str, Any] = {
        "workload": block.workload, "size": block.size, "terrain": block.terrain, "planner": name,
        "n": int(judged.sum()), "time_ms": _spread(times[judged]),
        "worst_call_ms": round(answers.worst_ms, 6),
        "fps": 1e3 / float(np.median(times[judged])),
        "stages_ms": _stages(answers, judged), "stages_share": {},
        "speedup_median": float(np.median(exact_times[judged] / times[judged])),
        "speedup_total": float(exact_times[judged].sum() / times[judged].sum()),
        "gap_mean": _of(np.mean, gaps[kept]), "gap_p99": _of(lambda each: np.quantile(each, 0.99), gaps[kept]),
        "gap_max": _of(np.max, gaps[kept]),
        "cc_excess": _excess(np.array(answers.traverse_cost)[kept], np.array(exact.traverse_cost)[kept]),
        "success_first": _share(answers, judged), "success": float(solved[judged].mean()),
        "expansions_median": float(np.median(np.array(answers.expansions)[judged])),
        "energy_mj": None if energy_problem else 1e3 * answers.energy_j / answers.calls,
        "inference_ms_median": None, "inference_fps": None, "int8_speedup": None,
    }  # fmt: skip
    whole = row["time_ms"]["mean"]
    row["stages_share"] = {stage: spread["mean"] / whole for stage, spread in row["stages_ms"].items()}
    if answers.network_ms[0]:
        row["inference_ms_median"] = _median_network(answers, judged)
        row["inference_fps"] = 1e3 / row["inference_ms_median"]
    if name == "nnpp" and "nnpp-fp32" in block.answers:
        row["int8_speedup"] = _median_network(block.answers["nnpp-fp32"], judged) / row["inference_ms_median"]
    row["halves"] = _halves(block, name, judged)
    row["queries"] = {
        "time_ms": [round(float(each), 4) for each in times],
        "distance": [question.apart for question in block.questions],
        "judged": judged.tolist(),
    }
    return row


def _halves(block: Block, name: str, judged: NDArray[np.bool_]) -> dict[str, list[float]]:
    """For each basis of a budget its median in either half."""
    answers, exact = block.answers[name], block.answers[EXACT]
    times = [answers.times(half)[judged] for half in range(HALVES)]
    exact_times = [exact.times(half)[judged] for half in range(HALVES)]
    found = {
        "time": [float(np.median(each)) for each in times],
        "ratio": [float(np.median(e / each)) for e, each in zip(exact_times, times, strict=True)],
    }
    if answers.network_ms[0]:
        found["inference"] = [_median_network(answers, judged, half) for half in range(HALVES)]
    if name == "nnpp" and (fp32 := block.answers.get("nnpp-fp32")) is not None:
        found["int8_ratio"] = [
            _median_network(fp32, judged, half) / _median_network(answers, judged, half) for half in range(HALVES)
        ]
    return found


def _spread(times: Times) -> dict[str, float]:
    p90, p99 = np.quantile(times, (0.90, 0.99))
    told = {"median": np.median(times), "p90": p90, "p99": p99, "max": times.max(), "mean": times.mean()}
    return {key: round(float(value), 6) for key, value in told.items()}


def _stages(answers: Answers, judged: NDArray[np.bool_]) -> dict[str, dict[str, float]]:
    """Each stage's times over the judged queries of both halves; one that a plan did without took it 0 ms."""
    plans = [stages for half in answers.stages_ms for stages, counts in zip(half, judged, strict=True) if counts]
    names = {stage for stages in plans for stage in stages}
    unknown = sorted(names - set(STAGES))
    ordered = [stage for stage in (*STAGES[:-1], *unknown, STAGES[-1]) if stage in names]
    return {stage: _spread(np.array([stages.get(stage, 0.0) for stages in plans])) for stage in ordered}


def _median_network(answers: Answers, judged: NDArray[np.bool_], half: int | None = None) -> float:
    halves = range(HALVES) if half is None else (half,)
    return float(np.median([np.array(answers.network_ms[at])[judged] for at in halves]))


def _share(answers: Answers, judged: NDArray[np.bool_]) -> float:
    first = np.array([source in _FIRST for source in answers.sources]) & np.array(answers.solved)
    return float(first[judged].mean())


def _excess(costs: Times, optima: Times) -> float | None:
    return float(costs.sum() / optima.sum() - 1.0) if len(costs) and optima.sum() > 0.0 else None


def _of(figure: Any, values: Times) -> float | None:
    return float(figure(values)) if len(values) else None


def find(results: list[dict[str, Any]], workload: str, size: int, planner: str) -> Mapping[str, Any] | None:
    """The row of a planner."""
    for row in results:
        if (row["workload"], row["size"], row["planner"]) == (workload, size, planner):
            return row
    return None
