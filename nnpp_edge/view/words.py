"""A question as a command and as Python, to be run elsewhere."""

import re
import shlex
from dataclasses import asdict

from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.view.asked import Asked, Site

_PLAIN = asdict(Traversability())


def command_of(site: Site, asked: Asked) -> str:
    """A line for a shell that plans the same path; without painted obstacles, which no option describes."""
    words = ["nnpp-edge", "plan", str(site.path)]
    for name, value in site.reading.items():
        option = f"--{name.removesuffix('_m').replace('_', '-')}"
        words += [option] if value is True else [option, _number(value)]
    for name, (row, col) in (("--start", asked.start), ("--goal", asked.goal)):
        words += [f"{name}={row},{col}"] if row < 0 or col < 0 else [name, f"{row},{col}"]
    words += ["--method", asked.method]
    for name, value in _limits(asked).items():
        words += ["--limit", f"{name}={_number(value)}"]
    if asked.slope_cost != "paper":
        words += ["--step-cost", asked.slope_cost]
    elif asked.weight != PAPER_OMEGA:
        words += ["--omega", _number(asked.weight)]
    words += [*([] if asked.corner_cutting else ["--no-corner-cutting"]), *asked.chosen(site).options]
    for name, value in asked.changes(site).items():
        words += ["--set", f"{name}={_number(value)}"]
    return shlex.join([*words, *(["--refine", asked.freed] if asked.freed else [])])


def python_of(site: Site, asked: Asked) -> str:
    """Lines of Python that plan the same path, painted obstacles included, as `plan`."""
    ground, given = asked.ground(site), dict(site.reading)
    steps = [f".{name}d({given.pop(name):.10g})" for name in ("rescale", "resample") if name in given]
    reading = ", ".join([repr(str(site.path)), *(f"{name}={value!r}" for name, value in given.items())])
    limits = ", ".join(f"{name}={value!r}" for name, value in _limits(asked).items())
    planner = f"""planner = Planner.of_elevation(
    dem.elevation, dem.cell_size_m, Traversability({limits}),
    cell_width_m=dem.cell_width_m, vehicle={ground.vehicle!r},
    step_cost={asked.slope_cost!r}, mobility={ground.mobility!r},
    omega={asked.weight!r}, corner_cutting={asked.corner_cutting},
)"""
    names = sorted({name.partition(".")[0] for name in re.findall(r"\b[A-Z][\w.]*(?=\()", planner)})
    lines = [
        *(["import numpy as np", ""] if asked.obstacles else []),
        f"from nnpp_edge.runtime import {', '.join(names)}",
        "from nnpp_edge.terrain.dem import read_dem",
        "",
        f"dem = read_dem({reading}){''.join(steps)}",
        planner,
        *(f"planner.update({row}, {col}, np.ones(({rows}, {cols})))" for row, col, rows, cols in asked.obstacles),
        f"plan = planner.plan({asked.start}, {asked.goal}, method={asked.method!r}, refine={asked.freed!r})",
        "print(plan.status, plan.cost, plan.timings_ms)",
        "",
    ]
    return "\n".join(lines)


def _limits(asked: Asked) -> dict[str, float]:
    """Limits that are not the defaults of `Traversability`."""
    return {name: value for name, value in asdict(asked.limits).items() if value != _PLAIN[name]}


def _number(value: float) -> str:
    """As a user writes it, and without loss."""
    return repr(int(value)) if float(value).is_integer() else repr(value)
