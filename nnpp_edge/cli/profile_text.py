"""A profile's report and a comparison of two, for people: tables on a terminal, or in Markdown."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from nnpp_edge.profiling.quantities import STAGES
from nnpp_edge.profiling.report_format import (
    BreakEven,
    BudgetLine,
    Comparison,
    LoadedRow,
    LoopRow,
    Report,
    ResultRow,
    Spread,
)
from nnpp_edge.progress import markdown_table, render_table

_BUDGETS = ("budget", "planner", "where", "measured", "wanted", "verdict")
_PLACE = ("workload", "size", "planner")
_TIMES = ("n", "ms\nmedian", "ms\np90", "ms\np99", "ms\nmax", "FPS", "network\nFPS", "speed-up\nmedian")
_ARRIVALS = ("first path\nof a map, ms", "ms\np99", "patch\nms", "ms\np99")
_LOOP = (
    "workload",
    "size",
    "method",
    "Hz",
    "patch",
    "n",
    "ms\nmedian",
    "ms\np90",
    "ms\np99",
    "ms\nmax",
    "new",
    "kept",
)
_LOADED = (*_PLACE, "alone, ms\nmedian", "ms\np99", "beside, ms\nmedian", "ms\np99", "times\nas long")
_QUALITY = ("speed-up\ntotal", "success", "after\nfallback", "gap\nmean", "gap\np99", "expan-\nsions")
_WHOLE_RUN = (
    ("peak_memory_mb", "peak memory", "MB"),
    ("model_mb", "model", "MB"),
    ("start_up_cold_s", "start cold", "s"),
    ("start_up_warm_s", "start warm", "s"),
)
"""Key, name and unit of what there is one figure of for each planner."""
_COMPARED = ("workload", "size", "planner", "figure", "before", "after", "worse by", "verdict")


def report_text(report: Report) -> str:
    """The whole report: budgets last, where the eye rests."""
    lines: list[str] = []
    for table in _tables(report):
        lines += [table.title] if table.title else []
        lines += [render_table(table.header, table.body, table.sections).strip("\n"), ""]
    lines += [*_sentences(report), "", *_machine(report), ""]
    if report["budgets"]:
        lines += [render_table(_BUDGETS, _budgets(report)).strip("\n"), ""]
    return "\n".join([*lines, *_reasons(report), report["summary"]])


def report_markdown(report: Report) -> str:
    """The whole report as Markdown: the verdict first."""
    parts = [f"# {report['profile']['title']}", report["summary"]]
    if report["budgets"]:
        parts += ["## Budgets", markdown_table(_BUDGETS, _budgets(report)), *_reasons(report)]
    for table in _tables(report):
        title = table.title or "times, speed-ups and path costs"
        parts += [f"## {title[:1].upper()}{title[1:]}", markdown_table(table.header, table.body)]
    parts += ["\n".join(f"- {line}" for line in _sentences(report)), "## Machine"]
    parts += ["\n".join(f"- {' '.join(line.split())}" for line in _machine(report))]
    return "\n\n".join(part for part in parts if part) + "\n"


class _Table(NamedTuple):
    title: str
    header: Sequence[str]
    body: list[list[str]]
    sections: Sequence[bool] = ()


def _tables(report: Report) -> Iterator[_Table]:
    results = report["results"]
    sections = _sections(results)
    yield _Table("", (*_PLACE, *_TIMES, *_QUALITY), [_result(row) for row in results], sections)
    found = {stage for row in results for stage in row["stages_ms"]}
    stages = [*sorted(found - set(STAGES)), *(stage for stage in STAGES if stage in found)]
    body = []
    for row in results:
        of_row = [_stage(row["stages_ms"].get(stage), row["stages_share"].get(stage)) for stage in stages]
        body.append([row["workload"], f"{row['size']}²", row["planner"], *of_row])
    yield _Table("mean ms by stage, and share of the whole", (*_PLACE, *stages), body, sections)
    if arrived := [row for row in results if row["map_ms"] is not None]:
        yield _Table(
            "maps and patches of elevations that have just arrived",
            (*_PLACE, *_ARRIVALS),
            [[row["workload"], f"{row['size']}²", row["planner"], *_arrivals(row)] for row in arrived],
        )
    if report["loop"]:
        title = "the onboard loop: from a patch's arrival to the checked path"
        yield _Table(title, _LOOP, [_reaction(row) for row in report["loop"]])
    if (contention := report["contention"]) is not None:
        title = f"alone, and beside {contention['beside']}"
        yield _Table(title, _LOADED, [_loaded(row) for row in contention["rows"]])


def _arrivals(row: ResultRow) -> Iterator[str]:
    for spread in (row["map_ms"], row["patch_ms"]):
        yield from ("–", "–") if spread is None else (_number(spread["median"]), _number(spread["p99"]))


def _reaction(row: LoopRow) -> list[str]:
    times, side = row["reaction_ms"], row["patch_side"]
    return [
        *(row["workload"], f"{row['size']}²", row["method"], f"{row['rate_hz']:g}", f"{side} × {side}"),
        str(row["n"]),
        *(_number(each) for each in (times["median"], times["p90"], times["p99"], times["max"])),
        *(str(row["planned"]), str(row["kept"])),
    ]


def _loaded(row: LoadedRow) -> list[str]:
    times = [_number(spread[key]) for spread in (row["idle_ms"], row["loaded_ms"]) for key in ("median", "p99")]
    return [row["workload"], f"{row['size']}²", row["planner"], *times, f"{row['factor']:.2f}"]


def _sentences(report: Report) -> Iterator[str]:
    yield from map(break_even_line, report["break_even"])
    if int8 := [row for row in report["results"] if row["int8_speedup"] is not None]:
        gains = ", ".join(f"{row['int8_speedup']:.2f} ({row['workload']} {row['size']}²)" for row in int8)
        yield f"int8 over fp32, the whole network alone: {gains}"
    if lost := sum(row["without_path"] for row in report["loop"]):
        yield f"the onboard loop had no path after {lost} patches"


def _machine(report: Report) -> Iterator[str]:
    facts = report["environment"]
    flags = ", ".join(facts["flags"]) or "none of note"
    yield f"machine      {facts['cpu']} ({flags}), cores {', '.join(map(str, report['cores']))}"
    governor = ", ".join(facts["governor"] or ()) or "–"
    yield f"             governor {governor}, load {' '.join(map(str, facts['load_average']))}"
    yield "packages     " + ", ".join(f"{name} {version or '–'}" for name, version in facts["packages"].items())
    for key, name, unit in _WHOLE_RUN:
        if by_planner := report["besides"].get(key):
            yield f"{name:<12} " + ", ".join(f"{who} {_number(value)} {unit}" for who, value in by_planner.items())
    if report["energy_problem"]:
        yield f"energy       – ({report['energy_problem']})"
    else:
        yield "energy       " + ", ".join(
            f"{row['planner']} {_number(row['energy_mj'])} mJ ({row['workload']} {row['size']}²)"
            for row in report["results"]
        )
    disturbance = report["disturbance"]
    shares = [max(half["waited_share"], half["others_share"] or 0.0) for half in disturbance["halves"]]
    yield f"others took  {' and '.join(f'{100 * share:.1f} %' for share in shares)} of the halves of the run"
    yield f"clocks       {_told(report['sensors']['clock_mhz'], 'core', 'MHz', 'limit')}"
    yield f"temperature  {_told(report['sensors']['temperature_c'], '', '°C', 'trip')}"
    if report["sensors"]["throttled"]:
        yield f"throttled    {report['sensors']['throttled']}"
    yield from (f"note         {line}" for line in report["notes"])


def _told(found: dict[str, dict[str, float | None]], what: str, unit: str, limit: str) -> str:
    """The range of each sensor's readings, and its limit."""
    ranges = [
        f"{what} {name} {_number(each['min'])} to {_number(each['max'])} {unit}"
        + (f" ({limit} {_number(each[limit])})" if each[limit] is not None else "")
        for name, each in found.items()
    ]
    return ", ".join(line.strip() for line in ranges) or "– (the kernel does not tell)"


def _budgets(report: Report) -> list[list[str]]:
    return [
        [line["name"], line["planner"], _where(line), *wanted(line), line["verdict"].upper()]
        for line in report["budgets"]
    ]


def _reasons(report: Report) -> list[str]:
    return [f"why: {why}" for why in dict.fromkeys(line["why"] for line in report["budgets"] if line["why"])]


def wanted(line: BudgetLine) -> tuple[str, str]:
    """Figures measured and wanted, with their unit."""
    unit = "" if line["unit"] == "1" else f" {line['unit']}"
    sign = "≥" if line["direction"] == "at least" else "≤"
    value = "–" if line["value"] is None else f"{_number(line['value'])}{unit}"
    return value, f"{sign} {line['limit']:g}{unit}"


def break_even_line(line: BreakEven) -> str:
    """A sentence on where one planner starts to pay over another."""
    where = "never in this run" if line["size_from"] is None else f"from {line['size_from']}² on"
    distances = []
    for size, cells in line["distance_from"].items():
        at = "never" if cells is None else "from the shortest on" if cells == 0 else f"from {cells} cells on"
        distances.append(f"{size}²: {at}")
    return f"{line['planner']} pays over {line['over']}: {where} (by distance, {'; '.join(distances)})"


def comparison_text(comparison: Comparison) -> str:
    """The figures that changed, and how the comparison ends."""
    changed = [line for line in comparison["lines"] if line["verdict"] != "same"]
    parts = [f"note: {line}" for line in comparison["notes"]]
    body = []
    for line in changed:
        values = [_number(line["before"]), _number(line["after"]), _percent(line["change"], "+.1f")]
        where = [line["workload"], f"{line['size']}²", line["planner"], line["figure"]]
        body.append([*where, *values, line["verdict"].upper()])
    if body:
        parts.append(render_table(_COMPARED, body).strip("\n"))
    worse = sum(line["verdict"] in ("worse", "noisy") for line in changed)
    doubt = ", all of them in a disturbed run" if comparison["verdict"] == "noisy" else ""
    tolerance = 100 * comparison["tolerance"]
    parts.append(f"{worse} of {len(comparison['lines'])} figures are worse by more than {tolerance:g} %{doubt}")
    return "\n".join(parts)


def _result(row: ResultRow) -> list[str]:
    times = row["time_ms"]
    return [
        *(row["workload"], f"{row['size']}²", row["planner"], str(row["n"])),
        *(_number(each) for each in (times["median"], times["p90"], times["p99"], times["max"])),
        f"{row['fps']:.0f}",
        "–" if row["inference_fps"] is None else f"{row['inference_fps']:.0f}",
        *(f"{each:.2f}" for each in (row["speedup_median"], row["speedup_total"])),
        *(_percent(each, ".1f") for each in (row["success_first"], row["success"])),
        *(_percent(each, ".2f") for each in (row["gap_mean"], row["gap_p99"])),
        f"{row['expansions_median']:.0f}",
    ]


def _stage(spread: Spread | None, share: float | None) -> str:
    return "–" if spread is None or share is None else f"{spread['mean']:.3f} {100 * share:3.0f} %"


def _where(line: BudgetLine) -> str:
    return "–" if line["size"] is None else f"{line['workload']} {line['size']}²"


def _sections(rows: Sequence[ResultRow]) -> list[bool]:
    places = [(row["workload"], row["size"]) for row in rows]
    return [at > 0 and place != places[at - 1] for at, place in enumerate(places)]


def _number(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def _percent(share: float | None, digits: str) -> str:
    return "–" if share is None else f"{100 * share:{digits}} %"
