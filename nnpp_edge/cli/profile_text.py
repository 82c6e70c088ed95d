"""A profile's report and a comparison of two, for people: tables on a terminal."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from nnpp_edge.profiling.quantities import STAGES
from nnpp_edge.progress import render_table

_BUDGETS = ("budget", "planner", "where", "measured", "wanted", "verdict")
_RESULTS = (
    "workload", "size", "planner", "n", "ms\nmedian", "ms\np90", "ms\np99", "ms\nmax", "FPS", "network\nFPS",
    "speed-up\nmedian", "speed-up\ntotal", "success", "after\nfallback", "gap\nmean", "gap\np99", "expan-\nsions",
)  # fmt: skip
_COMPARED = ("workload", "size", "planner", "figure", "before", "after", "worse by", "verdict")


def text(report: Mapping[str, Any]) -> str:
    """The whole report: budgets last, where the eye rests."""
    return "\n".join([*_measured(report), "", *_machine(report), "", *_budgets(report), report["summary"]])


def _measured(report: Mapping[str, Any]) -> Iterator[str]:
    results = report["results"]
    yield render_table(_RESULTS, [_result(row) for row in results], _sections(results)).strip("\n")
    found = {stage for row in results for stage in row["stages_ms"]}
    stages = [*sorted(found - set(STAGES)), *(stage for stage in STAGES if stage in found)]
    body = [
        [row["workload"], f"{row['size']}²", row["planner"],
         *(_stage(row["stages_ms"].get(stage), row["stages_share"].get(stage)) for stage in stages)]
        for row in results
    ]  # fmt: skip
    yield ""
    yield "mean ms by stage, and share of the whole"
    yield render_table(("workload", "size", "planner", *stages), body, _sections(results)).strip("\n")
    yield ""
    yield from map(break_even_line, report["break_even"])
    if int8 := [row for row in results if row["int8_speedup"] is not None]:
        told = ", ".join(f"{row['int8_speedup']:.2f} ({row['workload']} {row['size']}²)" for row in int8)
        yield f"int8 over fp32, the whole network alone: {told}"


def _machine(report: Mapping[str, Any]) -> Iterator[str]:
    facts, besides = report["environment"], report["besides"]
    flags = ", ".join(facts["flags"]) or "none of note"
    yield f"machine      {facts['cpu']} ({flags}), cores {', '.join(map(str, report['cores']))}"
    governor = ", ".join(facts["governor"] or ()) or "–"
    yield f"             governor {governor}, load {' '.join(map(str, facts['load_average']))}"
    yield "packages     " + ", ".join(f"{name} {version or '–'}" for name, version in facts["packages"].items())
    for key, name, unit in (
        ("peak_memory_mb", "peak memory", "MB"), ("model_mb", "model", "MB"),
        ("start_up_cold_s", "start cold", "s"), ("start_up_warm_s", "start warm", "s"),
    ):  # fmt: skip
        if besides.get(key):
            yield f"{name:<12} " + ", ".join(f"{who} {_number(value)} {unit}" for who, value in besides[key].items())
    if report["energy_problem"]:
        yield f"energy       – ({report['energy_problem']})"
    else:
        told = (f"{row['planner']} {_number(row['energy_mj'])} mJ ({row['workload']} {row['size']}²)"
                for row in report["results"])  # fmt: skip
        yield f"energy       {', '.join(told)}"
    disturbance = report["disturbance"]
    shares = [max(half["waited_share"], half["others_share"] or 0.0) for half in disturbance["halves"]]
    yield f"others took  {' and '.join(f'{100 * share:.1f} %' for share in shares)} of the halves of the run"
    yield from (f"note         {line}" for line in report["notes"])


def _budgets(report: Mapping[str, Any]) -> Iterator[str]:
    if report["budgets"]:
        body = [
            [line["name"], line["planner"], _where(line), *wanted(line), line["verdict"].upper()]
            for line in report["budgets"]
        ]  # fmt: skip
        yield render_table(_BUDGETS, body).strip("\n")
        yield ""
    for why in dict.fromkeys(line["why"] for line in report["budgets"] if line["why"]):
        yield f"why: {why}"


def wanted(line: Mapping[str, Any]) -> tuple[str, str]:
    """What was measured and what was wanted, with their unit."""
    unit = "" if line["unit"] == "1" else f" {line['unit']}"
    sign = "≥" if line["direction"] == "at least" else "≤"
    value = "–" if line["value"] is None else f"{_number(line['value'])}{unit}"
    return value, f"{sign} {line['limit']:g}{unit}"


def break_even_line(line: Mapping[str, Any]) -> str:
    """A sentence on where one planner starts to pay over another."""
    where = "never in this run" if line["size_from"] is None else f"from {line['size_from']}² on"
    told = []
    for size, cells in line["distance_from"].items():
        at = "never" if cells is None else "from the shortest on" if cells == 0 else f"from {cells} cells on"
        told.append(f"{size}²: {at}")
    return f"{line['planner']} pays over {line['over']}: {where} (by distance, {'; '.join(told)})"


def compared(told: Mapping[str, Any]) -> str:
    """The figures that changed, and how the comparison ends."""
    changed = [line for line in told["lines"] if line["verdict"] != "same"]
    parts = [f"note: {line}" for line in told["notes"]]
    if changed:
        body = [
            [line["workload"], f"{line['size']}²", line["planner"], line["figure"], _number(line["before"]),
             _number(line["after"]), "–" if line["change"] is None else f"{100 * line['change']:+.1f} %",
             line["verdict"].upper()]
            for line in changed
        ]  # fmt: skip
        parts.append(render_table(_COMPARED, body).strip("\n"))
    worse = sum(line["verdict"] in ("worse", "noisy") for line in changed)
    doubt = ", all of them in a disturbed run" if told["verdict"] == "noisy" else ""
    parts.append(
        f"{worse} of {len(told['lines'])} figures are worse by more than {100 * told['tolerance']:g} %{doubt}"
    )
    return "\n".join(parts)


def _result(row: Mapping[str, Any]) -> list[str]:
    times = row["time_ms"]
    return [
        row["workload"], f"{row['size']}²", row["planner"], str(row["n"]),
        *(_number(times[key]) for key in ("median", "p90", "p99", "max")), f"{row['fps']:.0f}",
        "–" if row["inference_fps"] is None else f"{row['inference_fps']:.0f}",
        *(f"{row[key]:.2f}" for key in ("speedup_median", "speedup_total")),
        *(f"{100 * row[key]:.1f} %" for key in ("success_first", "success")),
        *("–" if row[key] is None else f"{100 * row[key]:.2f} %" for key in ("gap_mean", "gap_p99")),
        f"{row['expansions_median']:.0f}",
    ]  # fmt: skip


def _stage(spread: Mapping[str, float] | None, share: float | None) -> str:
    return "–" if spread is None or share is None else f"{spread['mean']:.3f} {100 * share:3.0f} %"


def _where(line: Mapping[str, Any]) -> str:
    return "–" if line["size"] is None else f"{line['workload']} {line['size']}²"


def _sections(rows: Sequence[Mapping[str, Any]]) -> list[bool]:
    places = [(row["workload"], row["size"]) for row in rows]
    return [at > 0 and place != places[at - 1] for at, place in enumerate(places)]


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
