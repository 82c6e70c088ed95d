"""What is known of a path or a drive: each fact once, for programs, for people and for files of
maps.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from nnpp_edge.runtime.planners.plan import Plan


class Fact(NamedTuple):
    """A number or a word, as it is told wherever it is told."""

    name: str
    """In JSON, GeoJSON and GeoPackage."""
    value: object
    """None where it is not known."""
    unit: str = ""
    """One of `_FORMS`, or empty."""
    words: str = ""
    """For people: the name of the line where it stands, a colon, and words in which ``{}`` is the
    value with its unit; empty where people are not told.
    """


def plan_facts(
    plan: Plan, more: Iterable[Fact] = (), unit: str = "", optimality: str = ""
) -> list[Fact]:
    """The facts of a plan whose cost has a unit, with `more` that are known of its robot."""
    told = plan.summary()
    count = len(plan.path)
    along = plan.along
    by = along.time_by if along else ""
    energy = along and along.mobility.energy
    gravity = f" at {energy.gravity_m_s2:.3g} m/s²" if energy else ""
    cost_words = f"{f'{{}} {unit}'.rstrip()}, {optimality or plan.optimality}"

    # name, unit and words
    rows = [
        ("status", "", ""),
        ("method", "", ""),
        ("source", "", ""),
        ("cells", "", ""),
        ("length_m", "m", f"path: {count} cells, {{}}"),
        ("ground_length_m", "m", "ground: {} long"),
        ("climb_m", "m", "ground: {} up"),
        ("descent_m", "m", "ground: and {} down"),
        ("steepest_up_deg", "°", "ground: at most {} up"),
        ("steepest_down_deg", "°", "ground: and {} down"),
        ("time_s", "s", f"way: {{}} {by}"),
        ("energy_j", "J", f"way: {{}}{gravity}"),
        ("cost", "", f"cost: {cost_words}"),
    ]
    if plan.waypoints is not None:
        rows.append(
            ("line_cost", "", f"line: {len(plan.waypoints)} way points, line integral {{}}")
        )
        sharpest = f"sharpest_curvature_per_{'m' if along else 'cell'}"
        turns = "line: sharpest turn of {} radius" if told[sharpest] else ""
        rows.append((sharpest, "1/m", turns))
    found = [Fact(name, told[name], unit, words) for name, unit, words in rows]
    if plan.arcs:
        back = sum(arc.length_m for arc in plan.arcs if arc.gear < 0)
        sharpest_per_m = max(abs(arc.curvature_per_m) for arc in plan.arcs)
        sharpest = f", sharpest of {_radius(sharpest_per_m)} radius" if sharpest_per_m else ""
        words = f"arcs: {len(plan.arcs)} pieces{sharpest}, {{}} of them backwards"
        found.append(Fact("backwards_m", back, "m", words))
    found += [Fact("traverse_cost", told["traverse_cost"], "", "CC: {}"), *more]
    if not plan.ok:
        so_far = f"path: {count} cells so far, {{}}" if count else ""
        found = [each._replace(words=so_far * (each.name == "length_m")) for each in found]
    return [*found, Fact("expansions", told["expansions"], "", "expansions: {}")]


def values_of(facts: Iterable[Fact]) -> dict[str, object]:
    """Names and values, for programs."""
    return {fact.name: fact.value for fact in facts}


def lines_of(facts: Iterable[Fact]) -> dict[str, str]:
    """For people: what stands in each line, by its name."""
    lines: dict[str, str] = {}
    for fact in facts:
        name, _, words = fact.words.partition(": ")
        if not words or fact.value is None:
            continue
        told = words.format(_FORMS.get(fact.unit, _number)(fact.value))
        between = " " if told.startswith("and ") else ", "
        lines[name] = f"{lines[name]}{between}{told}" if name in lines else told
    return lines


def metres(length_m: float) -> str:
    """A length in words."""
    return f"{length_m:.4g} m" if length_m < 1000.0 else f"{length_m / 1000.0:.4g} km"


def duration(seconds: float) -> str:
    """A time in words."""
    if seconds < 60.0:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    parts = ((hours, "h"), (minutes, "min"), (0 if hours else rest, "s"))
    return " ".join(f"{number} {unit}" for number, unit in parts if number)


def work(joules: float) -> str:
    """An energy in words."""
    if joules < 1e6:
        return f"{joules / 1e3:.4g} kJ"
    return f"{joules / 1e6:.4g} MJ ({joules / 3.6e6:.3g} kWh)"


def _number(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _radius(curvature_per_m: float) -> str:
    return f"{1.0 / curvature_per_m:.3g} m"


_FORMS: dict[str, Callable[..., str]] = {
    "m": metres,
    "°": "{:.1f}°".format,
    "s": duration,
    "J": work,
    "1/m": _radius,
}
"""How people are told a value, by its unit."""
