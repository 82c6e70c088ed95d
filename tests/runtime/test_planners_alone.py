"""Methods and searchers on stand-ins for their neighbours, and the table of tuned numbers that they
go by.
"""

import ast
import inspect
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Planner, Region, Source, Status, Vehicle, tuning
from nnpp_edge.runtime.options import CELLS, STATES
from nnpp_edge.runtime.planners import methods as methods_module
from nnpp_edge.runtime.planners.mending import MendingSearcher
from nnpp_edge.runtime.planners.methods import Methods, pick_method
from nnpp_edge.runtime.region.learned import LearnedRegions
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import REFINE_FROM, CorridorWidth
from tests import oracles
from tests.strategies import state_of, uniform

SHAPE = (120, 160)
QUERY = Query((4, 5), (110, 150))
EVERYWHERE = Region.everywhere(*SHAPE)
NO_WAY = Search.without_path(Status.NO_PATH, 3, 1.0)
LATE = Search.without_path(Status.TIMEOUT)


def rough(shape=SHAPE):
    cost = uniform(7, shape, 0.0, 0.8)
    cost[uniform(8, shape) < 0.1] = np.inf
    cost[4, 5] = cost[110, min(150, shape[1] - 1)] = cost[110, 100] = 0.1
    return cost


COST = rough()
OPTIMUM = oracles.dijkstra(COST, QUERY.start)[QUERY.goal]


@pytest.fixture
def state():
    return state_of(COST)


class Recording:
    """A searcher that notes the regions' areas, and answers as it was told, and then with
    a search.
    """

    def __init__(self, searcher, answers=()):
        self.searcher = searcher
        self.answers = list(answers)
        self.areas = []

    def search(self, query, work, region, *_):
        self.areas.append(region.area())
        return self.answers.pop(0) if self.answers else self.searcher.search(query, work, region)


class GivenRegions:
    """In the place of a network: the regions that it was told, one after another."""

    def __init__(self, *regions):
        self.given = regions
        self.asked = []
        self.taken = 0

    def regions(self, start, goal, level, number, workspace, stopwatch, deadline):
        self.asked.append((start, goal, level.grid.shape, number))

        def each():
            for region in self.given:
                self.taken += 1
                yield region

        return 0.25, EVERYWHERE, each()


def test_d_star_lite_keeps_its_search_of_regions_from_one_query_to_the_next(state):
    astar = Methods(state).astar
    mending = MendingSearcher(state, astar)
    cost = COST.copy()
    works = [Work() for _ in range(4)]
    for work in works[:2]:
        mending.search(QUERY, work, EVERYWHERE)
    cost[8:11, 9:12] = np.inf
    state.update(8, 9, cost[8:11, 9:12])
    found = mending.search(QUERY, works[2], EVERYWHERE)
    wanted = oracles.dijkstra(cost, QUERY.start)[QUERY.goal]
    assert oracles.path_cost(found.path, cost) == pytest.approx(wanted, rel=1e-5)
    assert works[0].expansions > 100
    assert works[1].expansions == 0 < works[2].expansions < works[0].expansions / 2
    mending.search(QUERY._replace(goal=(20, 21)), Work(), EVERYWHERE)  # forgets the first goal
    mending.search(QUERY, works[3], EVERYWHERE)
    assert works[3].expansions > 100


def test_a_corridor_is_widened_then_given_up_for_the_map(state):
    methods = Methods(state)
    for answers, epsilon, searches, source in (
        ([], np.inf, 1, Source.REGION),
        ([NO_WAY], np.inf, 2, Source.WIDENED),
        ([NO_WAY] * 2, np.inf, 2, Source.FALLBACK),
        ([], 0.0, 2, Source.FALLBACK),  # until the path is good enough
        ([], 9.0, 1, Source.REGION),
        ([LATE], np.inf, 1, None),
    ):
        recording = Recording(methods.astar, answers)
        found = methods.corridor(QUERY._replace(epsilon=epsilon), Work(), recording)
        assert len(recording.areas) == searches and recording.areas == sorted(recording.areas)
        assert recording.areas[-1] < COST.size and (len(set(recording.areas)) == searches)
        if source is None:
            assert found.search.status is Status.TIMEOUT
            continue
        assert found.source is source and (found.region is None) == (source is Source.FALLBACK)
        assert found.cost >= OPTIMUM * (1 - 1e-5)
        assert (
            source is not Source.FALLBACK
            or found.cost == pytest.approx(OPTIMUM, rel=1e-5) == found.lower_bound
        )


def test_learned_regions_are_searched_in_turn_and_then_the_map(state):
    assert max(SHAPE) < REFINE_FROM
    methods = Methods(state, ask_from=0)
    for failures, source in enumerate(
        (Source.REGION, Source.WIDENED, Source.WIDENED, Source.FALLBACK)
    ):
        regions = methods.regions = GivenRegions(EVERYWHERE, EVERYWHERE, EVERYWHERE)
        recording = Recording(methods.astar, [NO_WAY] * failures)
        found = methods.network_region(QUERY, Work(), recording)
        assert (found.source, found.threshold) == (source, 0.25)
        assert found.network_region is not None and found.cost == pytest.approx(OPTIMUM, rel=1e-5)
        assert (
            regions.taken == len(recording.areas) == min(failures + 1, 3)
        )  # none is made before it is needed
        assert regions.asked == [(QUERY.start, QUERY.goal, SHAPE, 0)]
    for side, shown in (
        (REFINE_FROM - 1, (REFINE_FROM - 1, 120)),
        (REFINE_FROM, (REFINE_FROM // 4, 30)),  # searched coarsely
    ):
        methods = Methods(state_of(rough((side, 120))), ask_from=0)
        methods.regions = GivenRegions(None)
        recording = Recording(methods.astar)
        found = methods.network_region(QUERY._replace(goal=(110, 100)), Work(), recording)
        coarsely = side == REFINE_FROM
        assert methods.regions.asked[0][2:] == (shown, coarsely)
        assert found.search.status is Status.OK
        assert [area < side * 120 for area in recording.areas] == [True] * coarsely


def test_a_networks_regions_widen_and_hold_start_and_goal(state, network):
    level = state.pyramid.levels[1]
    learned = LearnedRegions(state, network)
    work = Work()
    learned.prepare(level, 1)
    td, at_td, regions = learned.regions(
        *QUERY[:2], level, 1, Workspace(len(level.grid.weights)), work
    )
    ends = tuple(np.array([QUERY.start, QUERY.goal]).T)
    assert 0.0 < td <= 1.0 and at_td.mask()[ends].all()
    first, wider, whole = (
        np.ones(level.grid.shape, bool) if each is None else each.mask() for each in regions
    )
    assert first[tuple(each // 4 for each in ends)].all()
    assert (first <= wider).all() and first.sum() < wider.sum() and whole.all()
    assert {"encode", "inference", "threshold"} <= set(work.timings_ms)


UNITS = "cells?|blocks?|share|times|levels?|landmarks?|rows?|expansions|changes|price|steps|distance|map|multipl"


def free(*shape):
    return np.full(shape, 0.2, np.float32)


def test_every_number_is_used_by_its_name_and_stands_with_its_unit():
    body = ast.parse(inspect.getsource(tuning)).body
    named = set()
    for statement, below in zip(body, [*body[1:], None], strict=True):
        if isinstance(statement, ast.Assign | ast.AnnAssign):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            names = [each.id for each in ast.walk(ast.Tuple(targets)) if isinstance(each, ast.Name)]
            text = (
                below.value.value
                if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
                else ""
            )
            named |= set(names)
            assert len(text.split()) >= 4, f"{names}: wanted a sentence below, got {text!r}"
            if not isinstance(
                getattr(tuning, names[0]), CorridorWidth
            ):  # whose fields say their units
                assert re.search(rf"\b({UNITS})", text, re.IGNORECASE), (
                    f"{names}: wanted a unit, got {text!r}"
                )
    assert named == {name for name in vars(tuning) if name.isupper()} and len(named) > 30
    table = Path(inspect.getfile(tuning))
    sources = "".join(path.read_text() for path in table.parent.rglob("*.py") if path != table)
    assert named <= set(re.findall(r"[A-Z][A-Z_]+", sources))


def test_auto_goes_by_distance_size_network_and_body(network):
    large = tuning.LARGE_MAP
    far = tuning.FAR
    near = tuning.NEAR
    for shape, model, over, methods in (
        ((256, 256), "edge", CELLS, "astar corridor corridor corridor"),
        ((large - 1, 30), "edge", CELLS, "astar corridor corridor corridor"),
        ((300, large), "edge", CELLS, "astar corridor corridor nnpp"),
        ((large, large), "edge-joint", CELLS, "astar corridor corridor corridor"),
        ((512, 512), "edge", STATES, "astar corridor corridor corridor"),
    ):
        moves = SimpleNamespace(over=over, near=near)
        grid = SimpleNamespace(robot=SimpleNamespace(moves=moves))
        state = SimpleNamespace(shape=shape, grid=grid)
        picked = [pick_method(state, model, apart) for apart in (near - 1, near, far - 1, far)]
        assert " ".join(str(method) for method, _ in picked) == methods and all(
            reason for _, reason in picked
        )
    planner = Planner(free(100, 100), model=network)
    for apart, asked in ((near - 1, False), (near, True)):
        assert ("inference" in planner.plan((0, 0), (apart, 0), method="nnpp").timings_ms) == asked


def test_auto_takes_the_corridor_where_the_network_s_regions_hold_no_path(monkeypatch):
    monkeypatch.setattr(methods_module, "LARGE_MAP", 64)
    monkeypatch.setattr(methods_module, "FAR", 60)
    nothing = (0.5, None, iter(()))
    monkeypatch.setattr(LearnedRegions, "regions", lambda *_: nothing)
    planner = Planner(free(100, 100))
    picked = planner.plan((3, 3), (90, 90))
    assert (picked.method, picked.source, picked.ok) == ("corridor", "region", True)
    assert "the network's regions hold no path" in picked.choice
    asked = planner.plan((3, 3), (90, 90), method="nnpp")
    assert (asked.method, asked.source) == ("nnpp", "fallback")


@pytest.mark.parametrize("wall", [50, 8])
def test_a_planner_tells_what_the_search_came_to_that_found_no_path(wall):
    cost = free(60, 60)
    cost[:, wall] = np.inf
    planner = Planner(cost)
    assert planner.plan((30, 2), (30, 58), method="astar").status == "NO_PATH"
    cells, from_start = planner.came_to((30, 2))
    assert from_start and cells[:, :wall].all() and not cells[:, wall:].any()
    heights = np.where(np.isinf(cost), 5.0, 0.0).astype(np.float32)
    body = Planner.of_elevation(heights, 0.5, vehicle=Vehicle(1.0, 0.8, 0.3))
    assert body.plan((30, 3), (30, 55), method="astar").status == "NO_PATH"
    cells, from_start = body.came_to((30, 3))
    assert cells[30, 55] and not from_start and not cells[:, : wall + 1].any()
    heights[:, wall:] = 5.0  # but for a pocket
    heights[26:35, 51:] = 0.0
    car = Planner.of_elevation(heights, 0.5, vehicle=Vehicle(1.0, 0.8, 0.3, turning_radius_m=1.0))
    assert car.plan((30, 3), (30, 55), method="astar").status == "NO_PATH"
    cells, from_start = car.came_to((30, 3))
    assert cells[30, 55] and not from_start and not cells[:, :51].any()


def test_a_brief_search_gives_up_after_its_expansions():
    cost = free(150, 150)
    cost[75, 1:] = np.inf
    methods = Methods(state_of(cost))
    work = Work()
    assert methods.search_briefly(Query((73, 140), (77, 140)), work) is None
    limit = tuning.BRIEF_EXPANSIONS + 2 * 4**2
    assert limit <= work.expansions <= limit + 8


@pytest.mark.parametrize(("apart", "picked"), [(tuning.NEAR - 1, "astar"), (235, "corridor")])
def test_auto_repairs_its_last_search_unless_the_goal_or_ground_near_it_changed(
    apart, picked, monkeypatch
):
    for name in ("LARGE_MAP", "FAR"):  # where a map that stands is planned on by the network
        monkeypatch.setattr(f"nnpp_edge.runtime.planners.methods.{name}", 100)
    planner = DynamicPlanner(free(40, 250), (20, 240))
    planner.move((20, 240 - apart))
    others = {"map", "region"} if picked == "astar" else {"region"}

    def found(by):
        plan = planner.replan()
        assert plan.planner == by == plan.summary()["method"] and plan.choice
        return plan

    assert found(picked).source in others
    planner.update(22, 247 - apart, free(1, 1) + 0.3)
    repaired = found("dstar")
    planner.update(20, 236, free(1, 1) + 0.3)
    assert repaired.source == "map" and planner.replan().source == "standing"
    planner.set_goal((21, 240))
    found(picked)
    planner.update(0, 243 - apart, np.full((40, 1), np.inf))
    plan = planner.replan()
    assert plan.status is Status.NO_PATH and plan.planner == "corridor"
