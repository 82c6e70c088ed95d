"""The findings of `nnpp-edge profile` for people: tables on a terminal, or in Markdown."""

from collections.abc import Iterable, Iterator, Sequence
from functools import partial

from nnpp_edge.cli.text import Columns, Row, aligned, columns, table
from nnpp_edge.profiling.compare import machine_words
from nnpp_edge.profiling.figures import stages_of
from nnpp_edge.profiling.judge import IN_WORDS, PASS, measured, place, wanted
from nnpp_edge.profiling.rows import Facts
from nnpp_edge.progress import MISSING
from nnpp_edge.runtime.errors import INSTALL

_PLACE = "workload | size: size ² | planner"
_RESULTS = columns(
    f"{_PLACE} | n | ms/median: time_ms.median | ms/p90: time_ms.p90 | ms/p99: time_ms.p99 | "
    "ms/max: time_ms.max | FPS: fps .0f | network/FPS: inference_fps .0f | "
    "int8 over/fp32, ×: int8_speedup .2f | speed-up/median, ×: speedup_median .2f | "
    "speed-up/total, ×: speedup_total .2f | "
    "success: success_first .1% | after/fallback: success .1% | gap/mean: gap_mean z.2% | "
    "gap/p99: gap_p99 z.2% | expansions: expansions_median .0f"
)
_ARRIVALS = columns(
    f"{_PLACE} | first path/of a map, ms: map_ms.median | p99,/ms: map_ms.p99 | "
    "patch,/ms: patch_ms.median | patch p99,/ms: patch_ms.p99"
)
_LOOP: Columns = {
    **columns("workload | size: size ² | method | Hz: rate_hz g"),
    "patch,\ncells": "{0[patch_side]} × {0[patch_side]}".format,
    **columns(
        "n | ms/median: reaction_ms.median | ms/p90: reaction_ms.p90 | ms/p99: reaction_ms.p99 | "
        "ms/max: reaction_ms.max | new: planned | kept | without/a path: without_path"
    ),
}
_PEERS = columns(
    "size | terrain | planner | n | ms/median: time_ms_median | ms/p95: time_ms_p95 | "
    "× astar/median: times_astar_median | map/ms: map_ms_median | gap/mean: gap_mean z.2% | "
    "gap/max: gap_max z.2% | same/optimum: same_optimum"
)


def report_text(report: Facts, *, markdown: bool = False) -> str:
    """The whole report: on a terminal the budgets come last, where the eye rests, in Markdown
    first.
    """
    results = report["results"]
    stages = {name: partial(_stage, name) for name in stages_of(results)}
    arrived = [row for row in results if row["map_ms"] is not None]
    head = "## " if markdown else ""
    bullet = "- " if markdown else ""

    def part(title: str, rows: Sequence[Row], as_: Columns) -> str:
        return f"{head}{title}\n\n{table(rows, as_, markdown=markdown)}" if rows else ""

    def lines(found: Iterable[str]) -> str:
        return "\n".join(f"{bullet}{line}" for line in found)

    verdict = [part("Budgets", report["budgets"], _BUDGETS), lines(_reasons(report["budgets"]))]
    measured = [
        part("Times, speed-ups and path costs", results, _RESULTS),
        part("Mean ms by stage, and share of the whole", results, columns(_PLACE) | stages),
        part("Maps and patches of elevations that have just arrived", arrived, _ARRIVALS),
        part("The onboard loop: from a patch's arrival to the checked path", report["loop"], _LOOP),
        f"{head}Machine",
        lines(f"{name}: {words}" for name, words in machine_words(report).items()),
        lines(f"note: {line}" for line in report["notes"]),
    ]
    parts = [*measured, *verdict, report["summary"]]
    if markdown:
        parts = [f"# {report['profile']['title']}", report["summary"], *verdict, *measured]
    return "\n\n".join(filter(None, parts)) + "\n" * markdown


def _reasons(budgets: Iterable[Row]) -> Iterator[str]:
    for line in budgets:
        if line["why"]:
            yield f"{line['name']} ({line['planner']}, {place(line)}): {line['why']}"


def _stage(name: str, row: Row) -> str:
    """A stage's mean and share, of a row of results."""
    if (spread := row["stages_ms"].get(name)) is None:
        return MISSING
    mean = spread["mean"]
    return f"{mean:.3f} {100 * mean / row['time_ms']['mean']:3.0f} %"


_BUDGETS: Columns = {
    "budget": lambda line: " ".join(line["name"].split()),
    "planner": "planner",
    "where": place,
    "measured": measured,
    "wanted": wanted,
    "verdict": lambda line: IN_WORDS[line["verdict"]].upper(),
}


def comparison_text(comparison: Facts) -> str:
    """The budgets that are not kept, and how the comparison ends."""
    lines = [line for line in comparison["budgets"] if line["verdict"] != PASS]
    parts = [f"note: {line}" for line in comparison["notes"]]
    if lines:
        parts.append(table(lines, _BUDGETS))
    return "\n".join([*parts, *_reasons(lines), comparison["summary"]])


def peers_text(rows: Sequence[Facts], missing: Sequence[str], *, markdown: bool = False) -> str:
    """The rows beside other libraries: the table, what each planner minimises, and who was left
    out.
    """
    minimised = {f"{row['planner']} {row['version']}": row["objective"] for row in rows}
    lines = [table(rows, _PEERS, markdown=markdown), "", "minimised:", aligned(minimised, "  ")]
    words = "{planner} at {size}: no path for {failed} queries"
    lines += [words.format(**row) for row in rows if row["failed"]]
    if missing:
        lines.append(f"left out, not installed: {', '.join(missing)} ({INSTALL.format('bench')})")
    return "\n".join(lines)
