"""A tab's question as a command and as Python, to be run elsewhere."""

import shlex
from dataclasses import asdict

from nnpp_edge.runtime.map.slope_cost import SLOPE_COSTS
from nnpp_edge.view.asked import Asked
from nnpp_edge.view.site import Site

_DEFAULTS = Asked(start=(0, 0), goal=(0, 0))


def command_of(site: Site, asked: Asked) -> str:
    """A line for a shell that plans the same path; without painted obstacles, which no option describes."""
    words = ["nnpp-edge", "plan", *site.reading.options]
    for name, (row, col) in (("--start", asked.start), ("--goal", asked.goal)):
        words += [f"{name}={row},{col}"] if row < 0 or col < 0 else [name, f"{row},{col}"]
    words += ["--method", asked.method]
    for name, value in _limits(asked).items():
        words += ["--limit", f"{name}={_number(value)}"]
    if asked.slope_cost != "paper":
        words += ["--step-cost", asked.slope_cost]
    elif asked.weight != _DEFAULTS.omega:
        words += ["--omega", _number(asked.weight)]
    words += [] if asked.corner_cutting else ["--no-corner-cutting"]
    words += asked.chosen(site).options
    for name, value in asked.changes(site).items():
        words += ["--set", f"{name}={_number(value)}"]
    words += ["--refine", asked.freed] if asked.freed else []
    return shlex.join(words)


def python_of(site: Site, asked: Asked) -> str:
    """Lines of Python that plan the same path, painted obstacles included, as `plan`."""
    body, changes = asked.chosen(site), asked.changes(site)
    vehicle, used = body.vehicle_code, f"{body.vehicle_code} {body.mobility_code}"
    limits = ", ".join(f"{name}={value!r}" for name, value in _limits(asked).items())
    lines = ["import numpy as np", ""] if asked.obstacles else []
    names = ["Planner", "Traversability"]
    if changes:
        vehicle = f"replace({vehicle}, {', '.join(f'{name}={value!r}' for name, value in changes.items())})"
        lines += ["from dataclasses import replace", ""]
    kinds = ("Mobility", "Vehicle", *(kind.__name__ for kind in SLOPE_COSTS.values()))
    names += [kind for kind in kinds if f"{kind}(" in used]
    lines += [
        f"from nnpp_edge.runtime import {', '.join(sorted(names))}",
        "from nnpp_edge.terrain.dem import read_dem",
    ]
    if "load_" in used:
        lines.append("from nnpp_edge.terrain.vehicle_files import load_mobility, load_vehicle")
    lines += [
        "",
        f"dem = {site.reading.code}",
        "planner = Planner.of_elevation(",
        f"    dem.elevation, dem.cell_size_m, Traversability({limits}),",
        f"    cell_width_m=dem.cell_width_m, vehicle={vehicle},",
        f"    step_cost={asked.slope_cost!r}, mobility={body.mobility_code},",
        f"    omega={asked.weight!r}, corner_cutting={asked.corner_cutting},",
        ")",
    ]
    for row, col, rows, cols in asked.obstacles:
        lines.append(f"planner.update({row}, {col}, np.ones(({rows}, {cols})))")
    more = f", refine={asked.freed!r}" if asked.freed else ""
    lines.append(f"plan = planner.plan({asked.start}, {asked.goal}, method={asked.method!r}{more})")
    return "\n".join([*lines, "print(plan.status, plan.cost, plan.timings_ms)", ""])


def _limits(asked: Asked) -> dict[str, float]:
    """Limits that are not the defaults of `Traversability`."""
    plain = asdict(_DEFAULTS.limits)
    return {name: value for name, value in asdict(asked.limits).items() if value != plain[name]}


def _number(value: float) -> str:
    """As a user writes it, and without loss."""
    return repr(int(value)) if float(value).is_integer() else repr(value)
