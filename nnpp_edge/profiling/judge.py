"""Budgets against figures: passed, missed, noisy, throttled or not measured."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from msgspec.structs import asdict, replace

from nnpp_edge.profiling.intervals import Interval
from nnpp_edge.profiling.profile_file import LOOP, Budget, Profile
from nnpp_edge.profiling.quantities import QUANTITIES
from nnpp_edge.profiling.rows import PLACE, Facts, Line, Rows
from nnpp_edge.profiling.sensors import Throttling
from nnpp_edge.progress import shown, with_unit

WholeRun = dict[str, dict[str, float]]
"""By quantity and planner, what there is one figure of for the run."""
PASS = "pass"
FAIL = "fail"
NOISY = "noisy"
THROTTLED = "throttled"
ABSENT = "not measured"
IN_WORDS = {PASS: "kept", FAIL: "missed"} | {state: state for state in (NOISY, THROTTLED, ABSENT)}
"""A budget's verdict, as people read it."""
MET = "met"
MISSED = "missed"
UNSURE = "noisy"
EXIT_CODES = {MET: 0, MISSED: 1, UNSURE: 3, THROTTLED: 3}
MOST_APART = 0.15
MOST_DISTURBED = 0.10
"""Shares by which medians of the halves of a run may differ, and of the time that others
may take.
"""
_TAKEN = {
    "others_share": "others took {:.0f} % of the cores' time",
    "waited_share": "the planners stood still for {:.0f} % of theirs",
}
"""What is said of the shares of a report's halves."""
_BEYOND_DOUBT = 1.25
"""In a noisy or throttled run a budget counts as missed where it would be missed by this factor
even without the time that was lost.
"""
_TEN_TIMES = 10.0
"""In a noisy run a budget is kept where it is by this factor."""
_BUDGET = ("name", "planner")
"""What a summary counts as one budget."""


class Noise(NamedTuple):
    """Time of others while the run was made."""

    words: str = ""
    """Empty if that is little."""
    share: float = 0.0
    """Of the time."""
    throttling: Throttling = Throttling()
    """Whether the processor was slowed."""


def noise_of(halves: Sequence[Facts], throttling: Throttling) -> Noise:
    """Noise in the half of a run in which others took most time."""
    shares = {}
    for key, words in _TAKEN.items():
        share = max(half[key] or 0.0 for half in halves)
        shares[words.format(100 * share)] = share
    signs = [words for words, share in shares.items() if share > MOST_DISTURBED]
    return Noise(" and ".join(signs), max(shares.values()), throttling)


def judged(
    profile: Profile,
    results: Sequence[Facts],
    whole_run: WholeRun,
    noise: Noise,
    loop: Sequence[Facts] = (),
) -> list[Facts]:
    """A line for each budget, at each workload and size that it is set for, by the rows of
    `figures`.

    A budget that passes on a throttled processor passes. One that is missed there counts as missed
    only if it would be missed at the full clock too; else it is ``throttled``.
    """
    of_loop = [{**row, "planner": LOOP} for row in loop]
    rows = {PLACE(row): row for row in [*results, *of_loop]}
    lines = []
    for budget in profile.budgets:
        if QUANTITIES[budget.quantity].whole_run:
            figure = whole_run.get(budget.quantity, {}).get(budget.planner)
            at = replace(budget, workload=None, size=None)
            lines.append(_line(at, figure, None, noise))
            continue
        for workload, size in profile.places(budget):
            row = rows.get((workload, size, budget.planner), {"halves": {}})
            at = replace(budget, workload=workload, size=size)
            halves = row["halves"].get(budget.basis)
            lines.append(_line(at, value_of(row, budget.quantity), halves, noise))
    return lines


def verdict(lines: Sequence[Facts], noise: Noise) -> str:
    """The verdict on the whole run: the first of missed, noisy (also for not measured) and
    throttled that any budget has, else met.
    """
    states = {line["verdict"] for line in lines}
    if not states:  # by the run itself
        states = {NOISY if noise.words else THROTTLED if noise.throttling.words else PASS}
    if FAIL in states:
        return MISSED
    if states & {NOISY, ABSENT}:
        return UNSURE
    return THROTTLED if THROTTLED in states else MET


def summary(ending: str, lines: Sequence[Facts], noise: str) -> str:
    """One line: the verdict, how many budgets have which, and the budgets that are to blame for
    it, with planner, workloads and sizes.
    """
    if not lines:
        return f"no budgets; the run was disturbed: {noise}" if noise else "no budgets"
    head, *blame = {
        MET: ("all budgets met",),
        MISSED: ("budgets missed", FAIL),
        THROTTLED: ("throttled", THROTTLED),
        UNSURE: ("too noisy to tell", NOISY, ABSENT),
    }[ending]
    counts = Counter(line["verdict"] for line in lines)
    counted = [f"{counts[state]} {words}" for state, words in IN_WORDS.items() if counts[state]]
    parts = [f"{head}: {', '.join(counted)}"]
    for state in blame:
        names = []
        for (name, planner), missed in Rows(lines).of(verdict=state).groups(_BUDGET).items():
            where = [planner, *(place(line) for line in missed if line["size"])]
            names.append(f"{name} ({', '.join(where)})")
        if names:
            parts.append(f"{IN_WORDS[state]}: {', '.join(names)}")
    return "; ".join(parts)


def place(line: Line) -> str:
    """Where a budget was judged, in words."""
    return f"{line['workload']} {line['size']}²" if line["size"] else "whole run"


def measured(line: Line) -> str:
    """A budget's figure with its unit; with more digits where it would look like the limit."""
    value = line["value"]
    if value is not None and value != line["limit"] and shown(value) == shown(line["limit"]):
        return with_unit(f"{value:g}", line["unit"])
    return with_unit(value, line["unit"])


def wanted(line: Line) -> str:
    """A budget's limit with its unit."""
    sign = "≥" if line["direction"] == "at least" else "≤"
    return with_unit(f"{sign} {line['limit']:g}", line["unit"])


def _line(
    at: Budget,
    figure: float | None,
    halves: Sequence[float] | None,
    noise: Noise,
) -> Facts:
    """The line of a budget at one place, by a report's figure and the medians of both halves."""
    value = None if figure is None else QUANTITIES[at.quantity].scale * figure
    halves = None if value is None else halves
    state, why = _verdict(at, value, halves, noise)
    return asdict(at) | {"value": value, "halves": halves, "verdict": state, "why": why}


def value_of(row: Facts, quantity: str) -> float | None:
    """A quantity's figure in a row, None where it was not measured; of a spread of times that has
    it, ``map_ms`` is the median and ``map_ms_p99`` says which.
    """
    value = row.get(quantity)
    spread, _, which = quantity.partition("_ms")
    figures = row.get(f"{spread}_ms")
    if isinstance(figures, Mapping):
        value = figures.get(which.removeprefix("_") or "median", value)
    return value if isinstance(value, int | float) else None


def _verdict(
    budget: Budget,
    value: float | None,
    halves: Sequence[float] | None,
    noise: Noise,
) -> tuple[str, str]:
    """A budget's verdict; with noise, and where it is none, also why."""
    if value is None:
        return ABSENT, "this run did not measure it"
    at_least = budget.direction == "at least"
    limits = {"least" if at_least else "most": budget.limit}
    kept = Interval(value, value, value).within(**limits)
    state = PASS if kept else FAIL
    if not budget.basis:
        return state, ""

    # signs of noise; of throttling, where there are none and a budget is missed
    apart = 0.0
    if halves is not None:
        apart = (max(halves) - min(halves)) / min(halves)
    unsure = NOISY
    words = noise.words
    lost = noise.share
    if apart > MOST_APART:
        words = f"the halves of the run differ by {100 * apart:.0f} %"
    if not words and not kept:
        unsure = THROTTLED
        words = noise.throttling.words
        lost = noise.throttling.share
        apart = 0.0
    if not words:
        return state, ""

    # how much worse the figure may be, and better: by the half that was disturbed less, with the
    # share of the time back that was lost
    worse = _TEN_TIMES if noise.words else (1.0 + apart) ** 2
    better = math.inf if lost == 1.0 else _BEYOND_DOUBT * (1.0 + apart) / (1.0 - lost)
    if at_least:
        worse, better = better, worse
    likely = Interval(value, value / better, value * worse)
    if likely.within(**limits) is None:
        return unsure, words
    return state, f"{words}, which explains no such {'margin' if kept else 'miss'}"
