"""A run's figures: what each planner did at each workload and size, as rows of a report."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.ground import patch_side
from nnpp_edge.profiling.measure import HALVES, Answers, Run, WorkloadRun
from nnpp_edge.profiling.profile_file import OnboardLoop
from nnpp_edge.profiling.quantities import LOOP, STAGES
from nnpp_edge.profiling.report_format import LoadedRow, LoopRow, QueryFacts, ResultRow, Spread
from nnpp_edge.profiling.rivals import EXACT, FIRST_SOURCES

Floats = NDArray[np.float64]
Chosen = NDArray[np.bool_]


def rows(run: Run) -> list[ResultRow]:
    """A row for each workload, size and planner, in order: the ``results`` of docs/profile.md."""
    return [_row(of, name, run.energy_problem) for of in run.workloads for name in of.answers]


def loop_rows(run: Run) -> list[LoopRow]:
    """A row for each workload and size at which the loop's reactions were measured."""
    return [_loop_row(of, run.loop) for of in run.workloads if of.reactions]


def loaded_rows(idle: Run, loaded: Run) -> list[LoadedRow]:
    """Both runs' times beside each other, of the planners and then of the loop."""
    found = [
        _loaded_row(one["workload"], one["size"], one["planner"], one["time_ms"], other["time_ms"])
        for one, other in zip(rows(idle), rows(loaded), strict=True)
    ]
    for of, other_of in zip(loop_rows(idle), loop_rows(loaded), strict=True):
        found.append(_loaded_row(of["workload"], of["size"], LOOP, of["reaction_ms"], other_of["reaction_ms"]))
    return found


def _loaded_row(workload: str, size: int, planner: str, idle: Spread, loaded: Spread) -> LoadedRow:
    factor = loaded["median"] / idle["median"]
    return LoadedRow(workload=workload, size=size, planner=planner, idle_ms=idle, loaded_ms=loaded, factor=factor)


def _loop_row(of: WorkloadRun, loop: OnboardLoop) -> LoopRow:
    halves = [each.ms for each in of.reactions]
    times = np.concatenate(halves)
    return LoopRow(
        workload=of.workload,
        size=of.size,
        method=loop.method,
        rate_hz=loop.rate_hz,
        patch_side=patch_side((of.size, of.size)),
        n=len(times),
        reaction_ms=_spread(times),
        planned=sum(each.planned for each in of.reactions),
        kept=sum(each.kept for each in of.reactions),
        without_path=sum(each.without_path for each in of.reactions),
        halves={"reaction": [float(np.median(half)) for half in halves]},
    )


def _row(of: WorkloadRun, name: str, energy_problem: str) -> ResultRow:
    answers, exact = of.answers[name], of.answers[EXACT]
    judged = np.array([query.judged for query in of.queries])
    times, exact_times = answers.times(), exact.times()
    cost, optimum = (np.array([plan.cost for plan in each.plans]) for each in (answers, exact))
    gaps = cost / optimum - 1.0
    solved = np.array([plan.ok for plan in answers.plans])
    kept = judged & solved
    whole, stages = _spread(times[judged]), _stages(answers, judged)
    network_ms = _median_network(answers, judged) if answers.network_ms[0] else None
    fp32 = of.answers.get("nnpp-fp32") if name == "nnpp" else None
    first = np.array([plan.source in (None, *FIRST_SOURCES) for plan in answers.plans]) & solved
    return ResultRow(
        workload=of.workload,
        size=of.size,
        terrain=of.terrain,
        planner=name,
        n=int(judged.sum()),
        time_ms=whole,
        worst_call_ms=round(answers.worst_ms, 6),
        fps=1e3 / float(np.median(times[judged])),
        stages_ms=stages,
        stages_share={stage: spread["mean"] / whole["mean"] for stage, spread in stages.items()},
        speedup_median=float(np.median(exact_times[judged] / times[judged])),
        speedup_total=float(exact_times[judged].sum() / times[judged].sum()),
        gap_mean=_of(np.mean, gaps[kept]),
        gap_p99=_of(lambda values: np.quantile(values, 0.99), gaps[kept]),
        gap_max=_of(np.max, gaps[kept]),
        cc_excess=_excess(_traverse_costs(answers)[kept], _traverse_costs(exact)[kept]),
        success_first=float(first[judged].mean()),
        success=float(solved[judged].mean()),
        expansions_median=float(np.median(np.array([plan.expansions for plan in answers.plans])[judged])),
        energy_mj=None if energy_problem else 1e3 * answers.energy_j / answers.calls,
        inference_ms_median=network_ms,
        inference_fps=network_ms and 1e3 / network_ms,
        int8_speedup=_median_network(fp32, judged) / network_ms if network_ms and fp32 else None,
        map_ms=_spread_of(answers.map_ms),
        patch_ms=_spread_of(answers.patch_ms),
        halves=_halves(of, name, judged),
        queries=QueryFacts(
            time_ms=[round(float(each), 4) for each in times],
            distance=[query.distance for query in of.queries],
            judged=judged.tolist(),
        ),
    )


def _halves(of: WorkloadRun, name: str, judged: Chosen) -> dict[str, list[float]]:
    """For each basis of a budget its median in either half."""
    answers, exact = of.answers[name], of.answers[EXACT]
    times = [answers.times(half)[judged] for half in range(HALVES)]
    exact_times = [exact.times(half)[judged] for half in range(HALVES)]
    found = {
        "time": [float(np.median(each)) for each in times],
        "ratio": [float(np.median(e / each)) for e, each in zip(exact_times, times, strict=True)],
    }
    for basis, arrivals in (("map", answers.map_ms), ("patch", answers.patch_ms)):
        if arrivals[0]:
            found[basis] = [float(np.median(half)) for half in arrivals]
    if answers.network_ms[0]:
        network = found["inference"] = [_median_network(answers, judged, half) for half in range(HALVES)]
        if name == "nnpp" and (fp32 := of.answers.get("nnpp-fp32")) is not None:
            found["int8_ratio"] = [_median_network(fp32, judged, half) / network[half] for half in range(HALVES)]
    return found


def _spread(times: Floats) -> Spread:
    median, p90, p99 = (round(float(each), 6) for each in np.quantile(times, (0.50, 0.90, 0.99)))
    largest, mean = round(float(times.max()), 6), round(float(times.mean()), 6)
    return Spread(median=median, p90=p90, p99=p99, max=largest, mean=mean)


def _spread_of(halves: list[list[float]]) -> Spread | None:
    """Of the means of both halves, query by query; None where nothing was measured."""
    return _spread(np.mean(halves, axis=0)) if halves[0] else None


def _stages(answers: Answers, judged: Chosen) -> dict[str, Spread]:
    """Each stage's times over the judged queries of both halves; one that a plan did without took it 0 ms."""
    plans = [stages for half in answers.stages_ms for stages, counts in zip(half, judged, strict=True) if counts]
    names = {stage for stages in plans for stage in stages}
    unknown = sorted(names - set(STAGES))
    ordered = [stage for stage in (*STAGES[:-1], *unknown, STAGES[-1]) if stage in names]
    return {stage: _spread(np.array([stages.get(stage, 0.0) for stages in plans])) for stage in ordered}


def _median_network(answers: Answers, judged: Chosen, half: int | None = None) -> float:
    halves = range(HALVES) if half is None else (half,)
    return float(np.median([np.array(answers.network_ms[at])[judged] for at in halves]))


def _traverse_costs(answers: Answers) -> Floats:
    return np.array([plan.traverse_cost for plan in answers.plans])


def _excess(costs: Floats, optima: Floats) -> float | None:
    return float(costs.sum() / optima.sum() - 1.0) if len(costs) and optima.sum() > 0.0 else None


def _of(figure: Callable[[Floats], np.floating], values: Floats) -> float | None:
    return float(figure(values)) if len(values) else None
