"""Budgets against figures: passed, missed, noisy, throttled or not measured."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from nnpp_edge.profiling.contest import Facts
from nnpp_edge.profiling.profile_file import LOOP, QUANTITIES, Budget, Profile
from nnpp_edge.profiling.sensors import Throttling

WholeRun = dict[str, dict[str, float]]
"""By quantity and planner, what there is one figure of for the run."""
PASS, FAIL, NOISY, THROTTLED, ABSENT = "pass", "fail", "noisy", "throttled", "not measured"
MET, MISSED, UNSURE = "met", "missed", "noisy"
EXIT_CODES = {MET: 0, MISSED: 1, UNSURE: 3, THROTTLED: 3}
_BEYOND_DOUBT = 1.25
"""In a noisy or throttled run a budget is missed where it would be by this factor with all the lost time back."""
_PLACES = 2
"""A budget that is missed in more places is named with their number."""


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
    profile: Profile, results: Sequence[Facts], whole_run: WholeRun, noise: Noise, loop: Sequence[Facts] = ()
) -> list[Facts]:
    """A line for each budget, at each workload and size that it is set for, by the rows of `figures`.

    What passes on a throttled processor passes; what is missed there is missed only where it would be at the full
    clock, too, and else ``throttled``.
    """
    rows = {(row["workload"], row["size"], row["planner"]): row for row in results}
    rows |= {(row["workload"], row["size"], LOOP): row for row in loop}
    lines = []
    for budget in profile.budgets:
        name, quantity = budget.quantity, QUANTITIES[budget.quantity]
        for place in ((None, None),) if quantity.whole_run else profile.places(budget):
            if quantity.whole_run:
                value, halves = whole_run.get(name, {}).get(budget.planner), None
            else:
                row = rows.get((*place, budget.planner), {"halves": {}})
                value, halves = _value(row, name), row["halves"].get(quantity.basis)
            lines.append(_line(budget, place, value, halves, profile.stability.halves, noise))
    return lines


def verdict(lines: Sequence[Facts], noise: Noise) -> str:
    """Of the whole run: missed, noisy (or not measured) or throttled if any budget is, in this order, else met."""
    states = {line["verdict"] for line in lines}
    if FAIL in states:
        return MISSED
    if states & {NOISY, ABSENT} or (noise.words and not lines):
        return UNSURE
    return THROTTLED if THROTTLED in states or (noise.throttling.words and not lines) else MET


def summary(ending: str, lines: Sequence[Facts], noise: str) -> str:
    """One line: the verdict, and the budgets that are to blame for it."""
    if not lines:
        return f"no budgets; the run was disturbed: {noise}" if noise else "no budgets"
    blame = {MISSED: (FAIL,), MET: (), THROTTLED: (THROTTLED,)}.get(ending, (NOISY, ABSENT))
    places: dict[str, list[str]] = {}
    for line in lines:
        if line["verdict"] in blame:
            where = [f"{line['workload']} {line['size']}²"] if line["size"] is not None else []
            places.setdefault(line["name"], []).extend(where)
    names = [
        f"{name} ({f'{len(where)} times' if len(where) > _PLACES else ', '.join(where)})" if where else name
        for name, where in places.items()
    ]
    passed = sum(line["verdict"] == PASS for line in lines)
    heads = {MET: "all budgets met", MISSED: "budgets missed", THROTTLED: "throttled"}
    head = heads.get(ending, "too noisy to tell")
    return f"{head}: {passed} of {len(lines)} pass" + (f"; not {', '.join(names)}" if names else "")


def _value(row: Facts, quantity: str) -> float | None:
    """A quantity's figure; of a spread of times, ``map_ms`` is the median and ``map_ms_p99`` says which."""
    figures: Mapping[str, object] = row
    spread, _, figure = quantity.partition("_ms")
    if isinstance(times := figures.get(f"{spread}_ms"), Mapping):
        figures, quantity = times, figure.removeprefix("_") or "median"
    value = figures.get(quantity)
    return value if isinstance(value, int | float) else None


def _line(
    budget: Budget,
    place: tuple[str | None, int | None],
    value: float | None,
    halves: Sequence[float] | None,
    allowed: float,
    noise: Noise,
) -> Facts:
    """A budget's line; `allowed` is the share by which the halves of the run may differ."""
    quantity = QUANTITIES[budget.quantity]
    shown = None if value is None else quantity.scale * value
    state, why = ABSENT, "this run did not measure it"
    apart: float | None = None
    if shown is not None:
        least = budget.direction == "at least"
        state, why = (PASS if (shown >= budget.limit if least else shown <= budget.limit) else FAIL), ""
        if quantity.basis and halves is not None:
            apart = abs(halves[0] - halves[1]) / min(halves)
        words = noise.words if quantity.basis else ""
        if apart is not None and apart > allowed:
            words = f"the halves of the run differ by {100 * apart:.0f} %"
        slowed = "" if words or not quantity.basis or state == PASS else noise.throttling.words
        if words or slowed:
            lost, differ = (noise.share, apart or 0.0) if words else (noise.throttling.share, 0.0)
            beyond = state == FAIL and _beyond_doubt(budget, shown, lost, differ)
            why = (words or slowed) + (", which explains no such miss" if beyond else "")
            state = FAIL if beyond else NOISY if words else THROTTLED
    halves_unit = None if not quantity.basis else "x" if "ratio" in quantity.basis else "ms"
    return {
        **{name: getattr(budget, name) for name in ("name", "quantity", "planner")},
        "workload": place[0],
        "size": place[1],
        **{name: getattr(budget, name) for name in ("direction", "limit", "unit")},
        "value": shown,
        "halves": None if apart is None else halves,
        "halves_unit": halves_unit,
        "halves_differ": apart,
        "verdict": state,
        "why": why,
    }


def _beyond_doubt(budget: Budget, value: float, lost: float, apart: float) -> bool:
    """Whether the better half would miss the limit even with the share of the time back that was `lost`."""
    wanted, got = (budget.limit, value) if budget.direction == "at least" else (value, budget.limit)
    return got <= 0.0 or (1.0 - lost) * wanted / (got * (1.0 + apart)) > _BEYOND_DOUBT
