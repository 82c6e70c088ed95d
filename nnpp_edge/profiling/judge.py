"""Budgets against figures: passed, missed, noisy, throttled or not measured."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from nnpp_edge.profiling.profile_file import Budget, Profile
from nnpp_edge.profiling.quantities import BASIS_UNITS, QUANTITIES
from nnpp_edge.profiling.report_format import BudgetLine, LoopRow, ResultRow, WholeRun, find
from nnpp_edge.profiling.sensors import Throttling

PASS, FAIL, NOISY, THROTTLED, ABSENT = "pass", "fail", "noisy", "throttled", "not measured"
MET, MISSED, UNSURE = "met", "missed", "noisy"
EXIT_CODES = {MET: 0, MISSED: 1, UNSURE: 3, THROTTLED: 3}
_BEYOND_DOUBT = 1.25
"""In a noisy or throttled run a budget is missed where it would be by this factor with all the lost time back."""


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
    profile: Profile, results: list[ResultRow], whole_run: WholeRun, noise: Noise, loop: Sequence[LoopRow] = ()
) -> list[BudgetLine]:
    """A line for each budget, at each workload and size that it is set for, by the rows of `figures`.

    What passes on a throttled processor passes; what is missed there is missed only where it would be at the full
    clock, too, and else ``throttled``.
    """
    lines = []
    for budget in profile.budgets:
        for workload, size in _places(budget, profile):
            if QUANTITIES[budget.quantity].whole_run:
                value, halves = whole_run.get(budget.quantity, {}).get(budget.planner), None
            else:
                row: ResultRow | LoopRow | None
                if QUANTITIES[budget.quantity].of_loop:
                    row = next((each for each in loop if (each["workload"], each["size"]) == (workload, size)), None)
                else:
                    row = find(results, str(workload), int(size or 0), budget.planner)
                value = row and _value(row, budget.quantity)
                halves = row and row["halves"].get(QUANTITIES[budget.quantity].basis)
            lines.append(_line(budget, (workload, size), value, halves, profile.stability.halves, noise))
    return lines


def verdict(lines: Sequence[BudgetLine], noise: Noise) -> str:
    """Of the whole run: missed, noisy (or not measured) or throttled if any budget is, in this order, else met."""
    states = {line["verdict"] for line in lines}
    if FAIL in states:
        return MISSED
    if states & {NOISY, ABSENT} or (noise.words and not lines):
        return UNSURE
    return THROTTLED if THROTTLED in states or (noise.throttling.words and not lines) else MET


def _places(budget: Budget, profile: Profile) -> Iterator[tuple[str | None, int | None]]:
    if QUANTITIES[budget.quantity].whole_run:
        yield None, None
        return
    yield from profile.places(budget)


def _value(row: ResultRow | LoopRow, quantity: str) -> float | None:
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
) -> BudgetLine:
    """A budget's line; `allowed` is the share by which the halves of the run may differ."""
    quantity = QUANTITIES[budget.quantity]
    shown = None if value is None else quantity.scale * value
    state, why = ABSENT, "this run did not measure it"
    apart: float | None = None
    if shown is not None:
        state, why = (PASS, "") if _holds(budget, shown) else (FAIL, "")
        if quantity.basis and halves is not None:
            apart = abs(halves[0] - halves[1]) / min(halves)
        words = noise.words if quantity.basis else ""
        if apart is not None and apart > allowed:
            words = f"the halves of the run differ by {100 * apart:.0f} %"
        if words and state == FAIL and _beyond_doubt(budget, shown, noise.share, apart or 0.0):
            why = f"{words}, which explains no such miss"
        elif words:
            state, why = NOISY, words
        elif quantity.basis and state == FAIL and noise.throttling.words:
            beyond = _beyond_doubt(budget, shown, noise.throttling.share, 0.0)
            why = noise.throttling.words + (", which explains no such miss" if beyond else "")
            state = FAIL if beyond else THROTTLED
    return BudgetLine(
        name=budget.name,
        quantity=budget.quantity,
        planner=budget.planner,
        workload=place[0],
        size=place[1],
        direction=budget.direction,
        limit=budget.limit,
        unit=budget.unit,
        value=shown,
        halves=list(halves) if apart is not None and halves is not None else None,
        halves_unit=BASIS_UNITS.get(quantity.basis),
        halves_differ=apart,
        verdict=state,
        why=why,
    )


def _holds(budget: Budget, value: float) -> bool:
    return value >= budget.limit if budget.direction == "at least" else value <= budget.limit


def _beyond_doubt(budget: Budget, value: float, lost: float, apart: float) -> bool:
    """Whether the better half would miss the limit even with the share of the time back that was `lost`."""
    wanted, got = (budget.limit, value) if budget.direction == "at least" else (value, budget.limit)
    return got <= 0.0 or (1.0 - lost) * wanted / (got * (1.0 + apart)) > _BEYOND_DOUBT
