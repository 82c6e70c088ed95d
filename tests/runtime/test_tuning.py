"""The table of tuned numbers: each is explained, warm-up follows it, and the planners do what it says."""

import ast
import inspect
import re
from pathlib import Path

import numpy as np

from nnpp_edge.runtime import DynamicMethod, DynamicPlanner, Planner, Status, exercises, tuning
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.pyramid import Pyramid, coarse_shapes
from nnpp_edge.runtime.map.state import map_state
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.planners import dynamic, searchers
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel, CoarseToFine
from nnpp_edge.runtime.planners.methods import MethodChooser, Methods
from nnpp_edge.runtime.planners.query import Query, Work
from nnpp_edge.runtime.planners.searchers import AStarSearcher
from nnpp_edge.runtime.region.map_view import MapView
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import CorridorWidth, MapSize

SOURCE = ast.parse(inspect.getsource(tuning))
SIZES = {name: value for name, value in vars(tuning).items() if isinstance(value, MapSize)}
UNITS = "cells?|blocks?|share|times|levels?|landmarks?|rows?|expansions|changes|price|steps|distance|map|multipl"


def constants():
    """Names of the constants, with the text below each; ones that are assigned together share it."""
    for statement, below in zip(SOURCE.body, [*SOURCE.body[1:], None], strict=True):
        if isinstance(statement, ast.Assign | ast.AnnAssign):
            text = below.value.value if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) else ""
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            yield [each.id for each in ast.walk(ast.Tuple(targets)) if isinstance(each, ast.Name)], text


def free(*shape):
    return np.full(shape, 0.2, np.float32)


def rough(*shape):
    return (np.random.default_rng(0).random(shape) * 0.6).astype(np.float32)


def test_every_number_stands_with_its_unit():
    named = []
    for names, text in constants():
        named += names
        assert text, f"{names}: wanted a text below"
        if not isinstance(getattr(tuning, names[0]), CorridorWidth):  # whose fields say their units
            assert re.search(rf"\b({UNITS})", text, re.IGNORECASE), f"{names}: wanted a unit, got {text!r}"
        assert len(text.split()) >= 4, f"{names}: wanted a sentence, got {text!r}"
    public = {name for name in vars(tuning) if name.isupper()}
    assert public == set(named)
    assert len(named) == len(set(named)) > 30


def test_every_number_is_used_by_its_name():
    """But for the sizes, which warm-up finds by their type."""
    table = Path(inspect.getfile(tuning))
    sources = "".join(path.read_text() for path in table.parent.rglob("*.py") if path != table)
    words = set(re.findall(r"[A-Z][A-Z_]+", sources))
    assert {name for names, _ in constants() for name in names} - SIZES.keys() <= words


# That they are what the planners go by


def test_from_refine_from_on_a_learned_region_is_searched_coarsely_first(network):
    size = int(tuning.REFINE_FROM)
    for side, coarsely in ((size - 1, False), (size, True)):
        planner = Planner(rough(side, 60), model=network, ask_from=0)
        plan = planner.plan((1, 1), (side - 2, 50), method="nnpp")
        assert plan.ok
        assert ("coarse" in plan.timings_ms) == coarsely


def test_on_a_large_map_a_far_goal_is_left_to_the_network():
    size, far = tuning.LARGE_MAP, tuning.FAR
    for side, apart, wanted in (
        (size, far, "nnpp"),
        (size, far - 1, "corridor"),
        (size - 1, far, "corridor"),
        (size, tuning.NEAR, "corridor"),
        (size, tuning.NEAR - 1, "astar"),
    ):
        chooser = MethodChooser((int(side), 30), "edge")
        assert chooser.choose("auto", Query((0, 0), (apart, 3)))[0] == wanted


def test_near_goals_are_found_before_the_network_is_shown_anything(network):
    planner = Planner(free(100, 100), model=network)
    for apart, asked in ((tuning.NEAR - 1, False), (tuning.NEAR, True)):
        assert ("inference" in planner.plan((0, 0), (apart, 0), method="nnpp").timings_ms) == asked


def test_a_brief_search_gives_up_after_its_expansions():
    cost = free(150, 150)
    cost[75, 1:] = np.inf
    methods, work = Methods(map_state(Ground(cost))), Work()
    assert methods.search_briefly(Query((73, 140), (77, 140)), work) is None
    limit = tuning.BRIEF_EXPANSIONS + 2 * 4**2
    assert limit <= work.expansions <= limit + 8


def test_the_top_level_is_the_coarsest_on_which_the_ends_are_far_enough_apart():
    state = map_state(Ground(free(1100, 20)))
    descent = CoarseToFine(state, Workspace(1))
    least = tuning.CELLS_APART * 4**2
    assert [descent.top_for(Query((0, 0), (apart, 0))) for apart in (2, least - 1, least, 1000)] == [1, 1, 2, 2]


def test_a_level_gets_landmarks_after_its_patience_and_no_more_than_it_should():
    state = map_state(Ground(rough(120, 120)))
    level = CoarseLevel(state.pyramid.levels[1])
    expanded = 0
    for _ in range(400):
        expanded += level.search((0, 0), (29, 29), None, beyond=0.02).expansions
        level.invest()
        if level.landmarks is None:
            assert expanded < tuning.LANDMARK_PATIENCE * level.grid.cells
    assert len(level.landmarks.cells) == tuning.LEVEL_LANDMARKS


def test_the_network_is_shown_a_window_up_to_a_share_of_the_map(network):
    side = 1000
    view = MapView(map_state(Ground(free(side, 30))), network)
    for apart in (10, 100, 250, 300):
        view.show((0, 0), (apart, 0))
        window = view.window
        if window != (0, 0, side, 30):
            assert window[2] <= tuning.WINDOW_SHARE * side
            assert window[0] % tuning.WINDOW_ROUNDING == window[2] % tuning.WINDOW_ROUNDING == 0
            assert window[2] >= 2 * apart
    assert view.window == (0, 0, side, 30)


def test_auto_mends_from_its_distance_on_and_a_near_goal_is_found_by_astar():
    for apart, wanted in (
        (tuning.NEAR - 1, DynamicMethod.ASTAR),
        (tuning.MEND_FROM - 1, DynamicMethod.CORRIDOR),
        (tuning.MEND_FROM, DynamicMethod.CORRIDOR_DSTAR),
    ):
        planner = DynamicPlanner(free(40, 250), (20, 240))
        planner.move((20, 240 - apart))
        assert planner.replan().ok
        assert planner.replan().planner is wanted


def test_a_wider_corridor_holds_more_cells_and_a_path_that_is_no_dearer():
    state = map_state(Ground(rough(300, 300)))
    searcher, areas, costs = AStarSearcher(state), [], []
    descent = CoarseToFine(state, searcher.workspace)
    for width in (tuning.LEARNED_CORRIDOR, tuning.CORRIDOR, tuning.WIDENED_CORRIDOR):
        search, region = descent.descend(Query((5, 5), (290, 280)), Work(), searcher, 1, None, width)
        areas.append(region.area())
        costs.append(state.grid.costs_of(search.path)[0])
    assert areas == sorted(areas) and 1.1 * areas[0] < areas[-1]
    assert costs == sorted(costs, reverse=True)


def test_warm_up_plans_on_a_map_below_and_one_above_every_size():
    assert set(SIZES) == {"SECOND_LEVEL_FROM", "REFINE_FROM", "LARGE_MAP"}
    sides = [max(shape) for shape in exercises.warmup_shapes()]
    for size in SIZES.values():
        assert min(sides) < size <= max(sides)
        others = sorted({*SIZES.values(), 0, 1 << 20} - {size})
        below, above = max(each for each in others if each < size), min(each for each in others if each > size)
        assert any(below <= side < size for side in sides) and any(size <= side < above for side in sides)


def test_from_second_level_from_on_there_is_a_second_level():
    size = int(tuning.SECOND_LEVEL_FROM)
    for narrow in (1, 40, 1000):
        assert [len(coarse_shapes(side, narrow)) for side in (size - 1, size)] == [1, 2]
        levels = Pyramid(Grid(size, narrow, StepModel.of("paper"))).levels
        assert max(levels[1].grid.shape) >= tuning.ANOTHER_LEVEL_FROM > max(levels[2].grid.shape)


def test_each_limit_of_mending_counts(monkeypatch):
    limits = (("MEND_SHARE", 0.0, "corridor"), ("MEND_WITHIN", 0.0, "corridor"), ("MEND_FROM", 1, "corridor-dstar"))
    for name, value, wanted in limits:
        planner = DynamicPlanner(free(40, 250), (20, 240))
        start = (20, 5 if wanted == "corridor" else 150)
        planner.move(start)
        planner.replan()
        planner.update(22, start[1] + 7, free(1, 1) + 0.3)
        with monkeypatch.context() as changed:
            changed.setattr(dynamic, name, value)
            assert planner.replan().planner == wanted
    for value, wanted in ((1e9, "searched afresh"), (0.0, "mended")):
        planner = DynamicPlanner(rough(120, 120), (110, 110), "corridor-dstar")
        monkeypatch.setattr(searchers, "DSTAR_SLOWER", value)
        for step in range(4):
            planner.move((5 + step, 5 + step))
            planner.update(14 + step, 14 + step, free(1, 1) * step)
            plan = planner.replan()
            assert plan.status is Status.OK and plan.choice.startswith(f"{wanted}:")


def test_auto_goes_by_distance_size_network_and_body():
    for shape, model, has_body, methods in (
        ((256, 256), "edge", False, "astar corridor corridor corridor"),
        ((300, 2048), "edge", False, "astar corridor corridor nnpp"),
        ((2048, 2048), "edge-joint", False, "astar corridor corridor corridor"),
        ((512, 512), "edge", True, "astar corridor corridor corridor"),
    ):
        picked = [MethodChooser(shape, model, has_body).pick(apart) for apart in (47, 48, 511, 512)]
        assert " ".join(str(method) for method, _ in picked) == methods and all(reason for _, reason in picked)
