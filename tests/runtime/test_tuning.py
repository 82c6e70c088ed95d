"""The table of tuned numbers: each is explained, warm-up follows it, and the planners do what it says."""

import ast
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicMethod, DynamicPlanner, Planner, tuning
from nnpp_edge.runtime.planners import dynamic, searchers
from nnpp_edge.runtime.planners.methods import MethodChooser, Methods
from nnpp_edge.runtime.planners.query import Query, Work
from nnpp_edge.runtime.tuning import CorridorWidth
from tests.strategies import state_of

UNITS = "cells?|blocks?|share|times|levels?|landmarks?|rows?|expansions|changes|price|steps|distance|map|multipl"


def free(*shape):
    return np.full(shape, 0.2, np.float32)


def rough(*shape):
    return (np.random.default_rng(0).random(shape) * 0.6).astype(np.float32)


def test_every_number_is_used_by_its_name_and_stands_with_its_unit():
    body, named = ast.parse(inspect.getsource(tuning)).body, set()
    for statement, below in zip(body, [*body[1:], None], strict=True):
        if isinstance(statement, ast.Assign | ast.AnnAssign):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            names = [each.id for each in ast.walk(ast.Tuple(targets)) if isinstance(each, ast.Name)]
            text = below.value.value if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) else ""
            named |= set(names)
            assert len(text.split()) >= 4, f"{names}: wanted a sentence below, got {text!r}"
            if not isinstance(getattr(tuning, names[0]), CorridorWidth):  # whose fields say their units
                assert re.search(rf"\b({UNITS})", text, re.IGNORECASE), f"{names}: wanted a unit, got {text!r}"
    assert named == {name for name in vars(tuning) if name.isupper()} and len(named) > 30
    table = Path(inspect.getfile(tuning))
    sources = "".join(path.read_text() for path in table.parent.rglob("*.py") if path != table)
    assert named <= set(re.findall(r"[A-Z][A-Z_]+", sources))


def test_from_refine_from_on_a_learned_region_is_searched_coarsely_first(network):
    size = tuning.REFINE_FROM
    for side, coarsely in ((size - 1, False), (size, True)):
        plan = Planner(rough(side, 60), model=network, ask_from=0).plan((1, 1), (side - 2, 50), method="nnpp")
        assert plan.ok and ("coarse" in plan.timings_ms) == coarsely


def test_auto_goes_by_distance_size_network_and_body(network):
    large, far, near = tuning.LARGE_MAP, tuning.FAR, tuning.NEAR
    for shape, model, has_body, methods in (
        ((256, 256), "edge", False, "astar corridor corridor corridor"),
        ((large - 1, 30), "edge", False, "astar corridor corridor corridor"),
        ((300, large), "edge", False, "astar corridor corridor nnpp"),
        ((large, large), "edge-joint", False, "astar corridor corridor corridor"),
        ((512, 512), "edge", True, "astar corridor corridor corridor"),
    ):
        picked = [MethodChooser(shape, model, has_body).pick(apart) for apart in (near - 1, near, far - 1, far)]
        assert " ".join(str(method) for method, _ in picked) == methods and all(reason for _, reason in picked)
    planner = Planner(free(100, 100), model=network)
    for apart, asked in ((near - 1, False), (near, True)):
        assert ("inference" in planner.plan((0, 0), (apart, 0), method="nnpp").timings_ms) == asked


def test_a_brief_search_gives_up_after_its_expansions():
    cost = free(150, 150)
    cost[75, 1:] = np.inf
    methods, work = Methods(state_of(cost)), Work()
    assert methods.search_briefly(Query((73, 140), (77, 140)), work) is None
    limit = tuning.BRIEF_EXPANSIONS + 2 * 4**2
    assert limit <= work.expansions <= limit + 8


def moving(apart=235):
    planner = DynamicPlanner(free(40, 250), (20, 240))
    planner.move((20, 240 - apart))
    assert planner.replan().ok
    return planner


def test_auto_mends_from_its_distance_on_and_a_near_goal_is_found_by_astar():
    for apart, wanted in (
        (tuning.NEAR - 1, DynamicMethod.ASTAR),
        (tuning.MEND_FROM - 1, DynamicMethod.CORRIDOR),
        (tuning.MEND_FROM, DynamicMethod.CORRIDOR_DSTAR),
    ):
        assert moving(apart).replan().planner is wanted


@pytest.mark.parametrize(
    ("name", "value", "apart", "wanted"),
    [
        ("MEND_SHARE", 0.0, 235, "corridor"),
        ("MEND_WITHIN", 0.0, 235, "corridor"),
        ("MEND_FROM", 1, 90, "corridor-dstar"),
    ],
)
def test_each_limit_of_mending_counts(name, value, apart, wanted, monkeypatch):
    planner = moving(apart)
    planner.update(22, 247 - apart, free(1, 1) + 0.3)
    monkeypatch.setattr(dynamic, name, value)
    assert planner.replan().planner == wanted


@pytest.mark.parametrize(("slower", "wanted"), [(1e9, "searched afresh"), (0.0, "mended")])
def test_a_region_is_mended_where_that_is_not_too_slow(slower, wanted, monkeypatch):
    planner = DynamicPlanner(rough(120, 120), (110, 110), "corridor-dstar")
    monkeypatch.setattr(searchers, "DSTAR_SLOWER", slower)
    for step in range(4):
        planner.move((5 + step, 5 + step))
        planner.update(14 + step, 14 + step, free(1, 1) * step)
        plan = planner.replan()
        assert plan.ok and plan.choice.startswith(f"{wanted}:")
