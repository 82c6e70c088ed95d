"""Budgets against figures: passed, missed, noisy, throttled or not measured."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from nnpp_edge.profiling.contest import Facts
from nnpp_edge.profiling.profile_file import LOOP, QUANTITIES, Budget, Profile
from nnpp_edge.profiling.sensors import Throttling

WholeRun = dict[str, dict[str, float]]
"""By quantity and planner, what there is one figure of for the run."""
PASS = "pass"
FAIL = "fail"
NOISY = "noisy"
THROTTLED = "throttled"
ABSENT = "not measured"
MET = "met"
MISSED = "missed"
UNSURE = "noisy"
EXIT_CODES = {MET: 0, MISSED: 1, UNSURE: 3, THROTTLED: 3}
MOST_APART = 0.15
MOST_DISTURBED = 0.10
"""Shares by which medians of the halves of a run may differ, and of the time that others
may take.
"""
_BEYOND_DOUBT = 1.25
"""In a noisy or throttled run a budget is missed where it would be by this factor with all the lost
time back.
"""
_TEN_TIMES = 10.0
"""In a noisy run a budget is kept where it is by this factor."""


@dataclass(frozen=True)
class Noise:
    """Time of others while the run was made."""

    words: str = ""
    """Empty if that is little."""
    share: float = 0.0
    """Of the time."""
    throttling: Throttling = field(default_factory=Throttling)
    """Whether the processor was slowed."""


def judged(
    profile: Profile,
    results: Sequence[Facts],
    whole_run: WholeRun,
    noise: Noise,
    loop: Sequence[Facts] = (),
) -> list[Facts]:
    """A line for each budget, at each workload and size that it is set for, by the rows of
    `figures`.

    What passes on a throttled processor passes; what is missed there is missed only where it would
    be at the full clock, too, and else ``throttled``.
    """
    rows = {(row["workload"], row["size"], row["planner"]): row for row in results}
    rows |= {(row["workload"], row["size"], LOOP): row for row in loop}
    lines = []
    for budget in profile.budgets:
        name = budget.quantity
        quantity = QUANTITIES[budget.quantity]
        for place in ((None, None),) if quantity.whole_run else profile.places(budget):
            row = rows.get((*place, budget.planner), {"halves": {}})
            value = (
                whole_run.get(name, {}).get(budget.planner)
                if quantity.whole_run
                else _value(row, name)
            )
            halves = None if value is None else row["halves"].get(quantity.basis)
            value = None if value is None else quantity.scale * value
            state, why = _verdict(budget, value, halves, noise)
            lines.append(
                {
                    **{key: getattr(budget, key) for key in ("name", "quantity", "planner")},
                    **dict(zip(("workload", "size"), place, strict=True)),
                    **{key: getattr(budget, key) for key in ("direction", "limit", "unit")},
                    "value": value,
                    "halves": halves,
                    "verdict": state,
                    "why": why,
                }
            )
    return lines


def verdict(lines: Sequence[Facts], noise: Noise) -> str:
    """Of the whole run: missed, noisy (or not measured) or throttled if any budget is, in this
    order, else met.
    """
    states = {line["verdict"] for line in lines}
    if FAIL in states:
        return MISSED
    if states & {NOISY, ABSENT} or (noise.words and not lines):
        return UNSURE
    return THROTTLED if THROTTLED in states or (noise.throttling.words and not lines) else MET


def summary(ending: str, lines: Sequence[Facts], noise: str) -> str:
    """One line: the verdict, and the budgets that are to blame for it, with planner, workloads and
    sizes.
    """
    if not lines:
        return f"no budgets; the run was disturbed: {noise}" if noise else "no budgets"
    head, blame = {
        MET: ("all budgets met", ()),
        MISSED: ("budgets missed", (FAIL,)),
        THROTTLED: ("throttled", (THROTTLED,)),
        UNSURE: ("too noisy to tell", (NOISY, ABSENT)),
    }[ending]
    places: dict[tuple[str, str], list[str]] = defaultdict(list)
    for line in (each for each in lines if each["verdict"] in blame):
        places[line["name"], line["planner"]] += (
            [f"{line['workload']} {line['size']}²"] if line["size"] else []
        )
    names = [
        f"{name} ({', '.join([planner, *where])})" for (name, planner), where in places.items()
    ]
    passed = sum(line["verdict"] == PASS for line in lines)
    return f"{head}: {passed} of {len(lines)} pass" + (f"; not {', '.join(names)}" if names else "")


def _value(row: Facts, quantity: str) -> float | None:
    """A quantity's figure; of a spread of times, ``map_ms`` is the median and ``map_ms_p99`` says
    which.
    """
    figures: Mapping[str, object] = row
    spread, _, figure = quantity.partition("_ms")
    if isinstance(times := figures.get(f"{spread}_ms"), Mapping):
        figures = times
        quantity = figure.removeprefix("_") or "median"
    value = figures.get(quantity)
    return value if isinstance(value, int | float) else None


def _verdict(
    budget: Budget, value: float | None, halves: Sequence[float] | None, noise: Noise
) -> tuple[str, str]:
    """A budget's verdict, and why it is none."""
    if value is None:
        return ABSENT, "this run did not measure it"
    least = budget.direction == "at least"
    state = PASS if (value >= budget.limit if least else value <= budget.limit) else FAIL
    if not QUANTITIES[budget.quantity].basis:
        return state, ""
    apart = abs(halves[0] - halves[1]) / min(halves) if halves is not None else 0.0
    words = (
        f"the halves of the run differ by {100 * apart:.0f} %"
        if apart > MOST_APART
        else noise.words
    )
    slowed = "" if words or state == PASS else noise.throttling.words
    if not (words or slowed):
        return state, ""
    lost, apart = (noise.share, apart) if words else (noise.throttling.share, 0.0)
    # beyond doubt: the better half would miss the limit even with the share of the time back that
    # was lost
    wanted, got = (budget.limit, value) if least else (value, budget.limit)
    if state == FAIL and (
        got <= 0.0 or (1.0 - lost) * wanted / (got * (1.0 + apart)) > _BEYOND_DOUBT
    ):
        return FAIL, f"{words or slowed}, which explains no such miss"
    if state == PASS and got >= _TEN_TIMES * wanted:
        return PASS, f"kept {_TEN_TIMES:g} times over, under load: {words}"
    return (NOISY, words) if words else (THROTTLED, slowed)
