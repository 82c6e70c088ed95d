"""Each planner and each searcher, made alone on a map; where that says more, on a stand-in for its neighbour."""

import math

import numpy as np
import pytest

from nnpp_edge.runtime.cells import as_cell
from nnpp_edge.runtime.deadline import Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
from nnpp_edge.runtime.planners.corridor import CorridorPlanner
from nnpp_edge.runtime.planners.exact import ExactPlanner, MendingExactPlanner
from nnpp_edge.runtime.planners.learned import LearnedPlanner
from nnpp_edge.runtime.planners.map_planners import MapPlanners
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Source
from nnpp_edge.runtime.planners.query import Found, Query, Work, problem_with
from nnpp_edge.runtime.planners.searchers import AStarSearcher, MendingSearcher, RegionMender
from nnpp_edge.runtime.region.learned import LearnedRegions, NetworkAnswer
from nnpp_edge.runtime.search.astar import Search
from nnpp_edge.runtime.tuning import CORRIDOR, LEARNED_CORRIDOR, REFINE_FROM, WIDENED_CORRIDOR
from tests import oracles

SHAPE = (120, 160)
QUERY = Query((4, 5), (110, 150))


def rough(shape=SHAPE):
    cost = (np.random.default_rng(7).random(shape) * 0.8).astype(np.float32)
    cost[np.random.default_rng(8).random(shape) < 0.1] = np.inf
    for row, col in ((4, 5), (50, 150), (110, 150), (110, 100)):
        cost[row, min(col, shape[1] - 1)] = 0.1
    return cost


@pytest.fixture
def cost():
    return rough()


@pytest.fixture
def state(cost):
    return MapState(cost, StepModel.of("paper"))


def optimum(cost, query=QUERY):
    return oracles.dijkstra(cost, query.start)[query.goal]


class Recording:
    """A searcher that notes the regions that it is given, and answers with a search of them or as it was told."""

    def __init__(self, searcher, answers=()):
        self.searcher, self.answers, self.areas, self.regions = searcher, list(answers), [], []

    def search(self, query, work, region):
        self.areas.append(region.area())
        self.regions.append(region.copy())
        return self.answers.pop(0) if self.answers else self.searcher.search(query, work, region)


class RecordingExact:
    """An exact planner that notes why it is asked for a path."""

    def __init__(self, searcher):
        self.exact, self.sources = ExactPlanner(searcher), []

    def find(self, query, work, source=Source.MAP):
        self.sources.append(source)
        return self.exact.find(query, work, source)

    def find_briefly(self, query, work):
        self.sources.append("briefly")
        return self.exact.find_briefly(query, work)


NO_WAY = Search.without_path(Status.NO_PATH, 3, 1.0)


# Searchers


def test_astar_searches_the_map_or_a_region_and_counts_its_work(state, cost):
    searcher, work = AStarSearcher(state), Work()
    whole = searcher.search(QUERY, work, None)
    first = work.expansions
    assert Found.of(state.grid, whole, Source.MAP, None, work).cost == pytest.approx(optimum(cost), rel=1e-5)
    assert first == whole.expansions > 0
    bitmap, lookup = np.zeros((2, 1), np.int32), (np.arange(120, dtype=np.int32) // 60, np.zeros(160, np.int32))
    bitmap[0] = 1
    upper = searcher.search(Query((4, 5), (50, 150)), work, Region(bitmap, *lookup))
    assert upper.path[:, 0].max() < 60
    assert work.expansions == first + upper.expansions
    assert set(work.timings_ms) == {"search", "path"}


def test_astar_gives_up_after_its_limit_or_its_deadline(state):
    searcher = AStarSearcher(state)
    assert searcher.search(QUERY, Work(), None, limit=50).status is Status.TIMEOUT
    with_landmarks = AStarSearcher(state)
    with_landmarks.prepare(2, [QUERY.goal])
    assert with_landmarks.search(QUERY, Work(), None).status is Status.OK
    large = AStarSearcher(MapState(np.random.default_rng(0).random((600, 600)) * 0.9, StepModel.of("paper")))
    late = Query((0, 0), (599, 599), deadline=Deadline.within(0.0))
    assert large.search(late, Work(), None).status is Status.TIMEOUT


def test_landmarks_are_set_at_goals_and_spread(state):
    searcher = AStarSearcher(state)
    assert searcher.landmarks is None
    searcher.prepare(3, [QUERY.goal])
    assert searcher.landmarks.cells[0] == QUERY.goal and len(searcher.landmarks.cells) == 4
    plain, work = Work(), Work()
    AStarSearcher(state).search(QUERY, plain, None)
    searcher.search(QUERY, work, None)
    assert work.expansions < plain.expansions
    with pytest.raises(InvalidQueryError, match="at most 8"):
        searcher.prepare(8, [QUERY.goal])
    assert len(searcher.landmarks.cells) == 4


def test_a_mender_keeps_its_search_from_one_query_to_the_next(state, cost):
    mender, everywhere = RegionMender(state), Region.everywhere(*SHAPE)
    assert not mender.knows_region(QUERY.goal)
    first, again = Work(), Work()
    mender.search(QUERY, first, everywhere)
    assert mender.knows_region(QUERY.goal) and not mender.knows_region(QUERY.start)
    found = mender.search(QUERY, again, everywhere)
    assert (first.expansions > 100, again.expansions) == (True, 0)
    assert Found.of(state.grid, found, Source.REGION, everywhere, again).cost == pytest.approx(
        optimum(cost), rel=1e-5
    )
    state.update(8, 9, np.full((3, 3), np.inf))
    cost[8:11, 9:12] = np.inf
    found, mended = mender.search(QUERY, again, None), again.expansions
    assert 0 < mended < first.expansions / 2
    assert Found.of(state.grid, found, Source.REGION, everywhere, again).cost == pytest.approx(
        optimum(cost), rel=1e-5
    )
    mender.expect((100, 20))
    assert not mender.knows_region((100, 20)) and not mender.knows_region(QUERY.goal)


def test_a_mender_that_forgot_everything_knows_no_region(state):
    mender, everywhere = RegionMender(state), Region.everywhere(*SHAPE)
    mender.search(QUERY, Work(), everywhere)
    near = QUERY._replace(start=(5, 6))
    work = Work()
    assert mender.worth_mending(near, work, everywhere)
    assert work.remark.startswith("mended: ")
    state.update(60, 60, np.zeros((1, 1)))  # cheaper than its heuristic allows for
    afresh = Work()
    assert not mender.worth_mending(near, afresh, everywhere)
    assert afresh.remark.startswith("searched afresh: ") and "times or more" in afresh.remark


@pytest.mark.parametrize("always", [False, True])
def test_a_mending_searcher_mends_or_searches_afresh(state, always):
    fresh, mender = AStarSearcher(state), RegionMender(state)
    searcher, everywhere, works = MendingSearcher(mender, fresh, always=always), Region.everywhere(*SHAPE), []
    for _ in range(2):
        works.append(Work())
        assert searcher.search(QUERY, works[-1], everywhere).status is Status.OK
    assert mender.knows_region(QUERY.goal) == always
    assert [bool(work.remark) for work in works] == [not always] * 2
    assert (works[1].expansions == 0) == always
    at_goal = searcher.search(Query(QUERY.goal, QUERY.goal), Work(), everywhere)
    assert at_goal.path.tolist() == [list(QUERY.goal)]


# Exact


def test_the_exact_planner_finds_the_optimum_and_says_why_it_searched(state, cost):
    planner, work = ExactPlanner(AStarSearcher(state)), Work()
    work.remark = "left by another"
    found = planner.find(QUERY, work, Source.FALLBACK)
    assert (found.source, found.region, work.remark) == (Source.FALLBACK, None, "")
    assert found.cost == pytest.approx(optimum(cost), rel=1e-5) == found.lower_bound
    assert found.suffices(QUERY._replace(epsilon=0.0))
    near = QUERY._replace(goal=(20, 22))
    assert planner.find_briefly(near, work).cost == pytest.approx(planner.find(near, work).cost)


def test_d_star_lite_over_the_whole_map_is_mended_and_takes_other_goals(state, cost):
    planner = MendingExactPlanner(state, ExactPlanner(AStarSearcher(state)))
    planner.prepare(QUERY.goal)
    works = [Work() for _ in range(4)]
    first = planner.find(QUERY, works[0])
    assert (first.source, first.region, first.cost) == (Source.MAP, None, pytest.approx(optimum(cost), rel=1e-5))
    state.update(6, 6, np.full((2, 3), 0.9))
    cost[6:8, 6:9] = 0.9
    assert planner.find(QUERY, works[1]).cost == pytest.approx(optimum(cost), rel=1e-5)
    assert works[1].expansions < works[0].expansions / 2
    other = QUERY._replace(goal=(4, 150))
    cost[4, 150] = 0.1
    state.update(4, 150, np.full((1, 1), 0.1))
    assert planner.find(other, works[2]).cost == pytest.approx(optimum(cost, other), rel=1e-5)
    late = QUERY._replace(deadline=Deadline.within(0.0))
    assert planner.find(late, works[3]).search.status is Status.TIMEOUT


# Coarse to fine


def test_a_descent_hands_its_searcher_a_corridor_around_the_coarse_path(state):
    astar = AStarSearcher(state)
    recording, descent = Recording(astar), CoarseToFine(state, astar.workspace)
    assert [level.grid.shape for level in descent.coarse_levels] == [(30, 40)]
    assert descent.workspace(0) is astar.workspace and descent.workspace(1) is descent.coarse_levels[0].workspace
    for width in (CORRIDOR, WIDENED_CORRIDOR):
        search, region = descent.descend(QUERY, Work(), recording, 1, None, width)
        assert search.status is Status.OK
        assert region.mask()[tuple(search.path.T)].all()
    first, wider = (region.mask() for region in recording.regions)
    assert (first <= wider).all() and 0 < first.sum() < wider.sum() <= first.size
    everything = Region.everywhere(*descent.coarse_levels[0].grid.shape)
    descent.descend(QUERY, Work(), recording, 1, everything, CORRIDOR)
    np.testing.assert_array_equal(recording.regions[-1].mask(), first)


def test_a_descent_without_a_way_is_none_and_without_time_an_error(state):
    astar = AStarSearcher(state)
    descent, nowhere = CoarseToFine(state, astar.workspace), Recording(astar, [NO_WAY])
    assert descent.descend(QUERY, Work(), nowhere, 1, None, CORRIDOR) is None
    recording, late = Recording(astar), QUERY._replace(deadline=Deadline.within(0.0))
    with pytest.raises(OutOfTimeError):
        descent.find(late, Work(), recording, 1, None, CORRIDOR, Source.REGION)
    assert recording.areas == []
    state.update(60, 0, np.full((1, 160), np.inf))
    recording = Recording(astar)
    assert descent.find(QUERY, Work(), recording, 1, None, CORRIDOR, Source.REGION) is None
    assert recording.areas == []  # the coarse level has no way


def test_a_descent_without_a_coarse_level_searches_the_region_it_is_given(state):
    astar = AStarSearcher(state)
    recording, region = Recording(astar), Region.everywhere(*SHAPE)
    found = CoarseToFine(state, astar.workspace).find(QUERY, Work(), recording, 0, region, CORRIDOR, Source.WIDENED)
    assert (recording.areas, found.source) == ([120 * 160], Source.WIDENED)


# Corridor


def corridor_of(state, answers=()):
    astar = AStarSearcher(state)
    recording, exact = Recording(astar, answers), RecordingExact(astar)
    return CorridorPlanner(CoarseToFine(state, astar.workspace), recording, exact), recording, exact


def test_a_corridor_is_widened_then_given_up_for_the_map(state, cost):
    for failures, source in ((0, Source.REGION), (1, Source.WIDENED), (2, Source.FALLBACK)):
        planner, recording, exact = corridor_of(state, [NO_WAY] * failures)
        found = planner.find(QUERY, Work())
        assert found.source is source
        assert len(recording.areas) == min(failures + 1, 2)
        assert recording.areas == sorted(recording.areas)
        assert exact.sources == [Source.FALLBACK] * (failures == 2)
        assert found.cost >= optimum(cost) * (1 - 1e-5)
        assert (found.region is None) == (failures == 2)


def test_a_corridor_is_widened_until_the_path_is_good_enough(state, cost):
    planner, recording, exact = corridor_of(state)
    found = planner.find(QUERY._replace(epsilon=0.0), Work())
    assert found.cost == pytest.approx(optimum(cost), rel=1e-5)
    assert exact.sources == [Source.FALLBACK] and len(recording.areas) == 2
    plenty = planner.find(QUERY._replace(epsilon=9.0), Work())
    assert plenty.source is Source.REGION and len(recording.areas) == 3


def test_a_corridor_is_not_widened_when_time_is_up(state):
    planner, recording, exact = corridor_of(state, [Search.without_path(Status.TIMEOUT)])
    assert planner.find(QUERY, Work()).search.status is Status.TIMEOUT
    assert (len(recording.areas), exact.sources) == (1, [])


# The network's region


class GivenRegions:
    """In the place of a network: the regions that it was told, one after another."""

    def __init__(self, *regions):
        self.given, self.asked, self.taken = regions, [], 0

    def regions(self, start, goal, level, number, workspace, stopwatch, deadline):
        self.asked.append((start, goal, level.grid.shape, number))

        def each():
            for region in self.given:
                self.taken += 1
                yield region

        return NetworkAnswer(0.25, Region.everywhere(*SHAPE)), each()


def learned_of(state, regions, answers=(), network_from=0):
    astar = AStarSearcher(state)
    recording, exact = Recording(astar, answers), RecordingExact(astar)
    descent = CoarseToFine(state, astar.workspace)
    return LearnedPlanner(state, regions, descent, recording, exact, network_from), recording, exact


def test_learned_regions_are_searched_in_turn_and_then_the_map(state, cost):
    assert max(SHAPE) < REFINE_FROM
    everywhere = Region.everywhere(*SHAPE)
    for failures, source in ((0, Source.REGION), (1, Source.WIDENED), (2, Source.WIDENED), (3, Source.FALLBACK)):
        regions = GivenRegions(everywhere, everywhere, everywhere)
        planner, recording, exact = learned_of(state, regions, [NO_WAY] * failures)
        found = planner.find(QUERY, Work())
        assert (found.source, found.threshold) == (source, 0.25)
        assert found.network_region is not None
        assert found.cost == pytest.approx(optimum(cost), rel=1e-5)
        assert regions.taken == len(recording.areas) == min(failures + 1, 3)  # none is made before it is needed
        assert regions.asked == [(QUERY.start, QUERY.goal, SHAPE, 0)]
        assert exact.sources == [Source.FALLBACK] * (failures == 3)


def test_on_a_larger_map_learned_regions_are_searched_on_the_coarsest_level(tiny_model):
    shape = (REFINE_FROM, 120)
    state = MapState(rough(shape), StepModel.of("paper"))
    regions = GivenRegions(None)
    planner, recording, _ = learned_of(state, regions)
    found = planner.find(QUERY._replace(goal=(110, 100)), Work())
    assert regions.asked[0][2:] == ((REFINE_FROM // 4, 30), 1)
    assert found.search.status is Status.OK and recording.areas[0] < shape[0] * shape[1]


def test_near_goals_are_found_without_asking_the_network(state):
    regions = GivenRegions()
    planner, _, exact = learned_of(state, regions, network_from=40)
    found = planner.find(Query((4, 5), (20, 30)), Work())
    assert (found.source, exact.sources, regions.asked) == (Source.MAP, ["briefly"], [])
    assert math.isnan(found.threshold)
    planner.find(QUERY, Work())
    assert exact.sources == ["briefly", Source.FALLBACK] and len(regions.asked) == 1


def test_a_networks_regions_widen_and_hold_start_and_goal(state, network):
    astar, level = AStarSearcher(state), state.pyramid.levels[1]
    descent = CoarseToFine(state, astar.workspace)
    learned, work = LearnedRegions(state, network), Work()
    learned.prepare(level, 1)
    answer, regions = learned.regions(*QUERY[:2], level, 1, descent.workspace(1), work)
    assert 0.0 < answer.threshold <= 1.0
    ends = tuple(np.array([QUERY.start, QUERY.goal]).T)
    assert answer.region.mask()[ends].all()
    masks = []
    for region in regions:
        masks.append(np.ones(level.grid.shape, bool) if region is None else region.mask())
        assert masks[-1][tuple(each // 4 for each in ends)].all()
        found = descent.find(QUERY, work, astar, 1, region, LEARNED_CORRIDOR, Source.REGION)
        assert found.search.status is Status.OK
    assert len(masks) == 3
    first, wider, whole = masks
    assert (first <= wider).all() and first.sum() < wider.sum()
    assert whole.all()
    assert {"encode", "inference", "threshold"} <= set(work.timings_ms)


# All of one map


def test_what_several_planners_need_is_made_once(state, network):
    planners = MapPlanners(state, network)
    assert planners.planner(Method.ASTAR) is planners.exact
    assert planners.planner(Method.CORRIDOR) is planners.corridor is planners.dynamic(DynamicMethod.CORRIDOR)
    assert planners.planner(Method.NNPP) is planners.learned is planners.dynamic(DynamicMethod.NNPP)
    assert planners.dynamic(DynamicMethod.DSTAR) is planners.exact_mending
    assert planners.dynamic(DynamicMethod.CORRIDOR_DSTAR) is planners.corridor_mending
    assert planners.dynamic(DynamicMethod.NNPP_DSTAR) is planners.learned_mending
    assert planners.coarse_to_fine.workspace(0) is planners.astar.workspace


@pytest.mark.parametrize("method", [method for method in DynamicMethod if method is not DynamicMethod.AUTO])
def test_every_method_finds_a_path_that_costs_little_more_than_the_optimum(state, network, cost, method):
    work = Work()
    found = MapPlanners(state, network).dynamic(method).find(QUERY, work)
    assert found.search.status is Status.OK
    assert optimum(cost) * (1 - 1e-5) <= found.cost <= 1.1 * optimum(cost)
    plan = found.plan(method.base, work, planner=method)
    assert (plan.planner, plan.method, plan.expansions) == (method, method.base, work.expansions)


def test_a_query_knows_its_distance_and_what_forbids_it(state):
    assert Query((3, 9), (7, 2)).apart == 7
    assert Query.of((0, 0), (1, 1), Deadline.within(60.0)).deadline.left_s > 30.0
    state.update(9, 9, np.full((1, 1), np.inf))
    for start, goal, wanted in (
        ((4, 5), (110, 150), None),
        ((-1, 0), (200, 0), Status.START_OUTSIDE_MAP),
        ((4, 5), (0, 160), Status.GOAL_OUTSIDE_MAP),
        ((9, 9), (9, 9), Status.START_BLOCKED),
        ((4, 5), (9, 9), Status.GOAL_BLOCKED),
    ):
        assert problem_with(state.grid, start, goal) is wanted
    assert as_cell(np.array([3, 4]), "goal") == as_cell((3.0, 4), "goal") == (3, 4)
    for wrong in ((1.5, 2), 7, "ab", (1, 2, 3), (math.nan, 1)):
        with pytest.raises(InvalidQueryError, match="goal must be two whole numbers"):
            as_cell(wrong, "goal")
