"""A profile's report as one page of HTML that needs nothing else: style, plots and pictures stand in it."""

import base64
from collections.abc import Iterator
from importlib.resources import files
from itertools import chain, islice

import cv2
import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from nnpp_edge.profiling.contest import Facts
from nnpp_edge.profiling.profile_file import Profile
from nnpp_edge.profiling.profile_maps import ProfileMaps
from nnpp_edge.progress import shown
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.viz.picture import plan_picture
from nnpp_edge.viz.profile_plots import plots
from nnpp_edge.viz.sheet import Picture

_TEMPLATE = "profile.html.j2"
_EXAMPLES = 3
_TRIES = 20
_WIDTH = 640
"""Pixels of an example's picture."""


def page(report: Facts, profile: Profile) -> str:
    """The page of a report, with example plans from the terrain of the profile that it was made by."""
    template = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template.filters |= {"number": _number, "percent": lambda share, digits=1: shown(share, f"z.{digits}%")}
    text = (files("nnpp_edge.viz") / _TEMPLATE).read_text(encoding="utf-8")
    return template.from_string(text).render(
        report=report,
        plots=[(title, words, Markup(svg)) for title, words, svg in plots(report)],
        examples=[(words, _data_uri(picture)) for words, picture in example_plans(profile)],
    )


def example_plans(profile: Profile) -> Iterator[tuple[str, Picture]]:
    """Up to three plans of the learned region beside the optimum, of each workload, and what they show."""
    size, names = min(profile.load.sizes), profile.load.workloads[:_EXAMPLES]
    model = NetworkModel(profile.networks.int8, threads=profile.device.threads)
    per_workload = -(-_EXAMPLES // len(names)) if len(names) > 1 else _EXAMPLES
    maps = ProfileMaps(profile.load)
    found = (islice(_examples(maps, name, size, model), per_workload) for name in names)
    return islice(chain.from_iterable(found), _EXAMPLES)


def _examples(maps: ProfileMaps, name: str, size: int, model: NetworkModel) -> Iterator[tuple[str, Picture]]:
    """Plans of the first query of some maps, where it has a path."""
    for on_map in islice(maps.maps(name, size), _TRIES):
        start, goal = on_map.queries[0].ends
        exact = Planner(on_map.cost).plan(start, goal, method=Method.ASTAR)
        if exact.ok:
            plan = Planner(on_map.cost, model=model).plan(start, goal, method=Method.NNPP, keep_regions=True)
            picture = plan_picture(on_map.cost, plan, start=start, goal=goal, reference_path=exact.path)
            yield _words(name, size, plan, exact), picture


def _words(name: str, size: int, plan: Plan, exact: Plan) -> str:
    gap = 100.0 * (plan.cost / exact.cost - 1.0) if exact.cost else 0.0
    return f"{name}, {size}²: nnpp, {gap:.2f} % above the optimum, {plan.expansions} of {exact.expansions} expansions"


def _data_uri(picture: Picture) -> str:
    factor = min(1.0, _WIDTH / picture.shape[1])
    small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    # few colours, evenly spaced: half the size, and no difference to the eye
    small = np.minimum(small.astype(np.int32) // 8 * 8 + 4, 255).astype(np.uint8)
    done, content = cv2.imencode(".png", small, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert done
    return "data:image/png;base64," + base64.b64encode(content.tobytes()).decode()


def _number(value: float | None, unit: str = "") -> str:
    return shown(value) if value is None or unit in ("", "1") else f"{shown(value)} {unit}"
