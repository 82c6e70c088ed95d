"""Each planner and each searcher, made alone on a map; where that says more, on a stand-in for its neighbour."""

import math

import numpy as np
import pytest

from nnpp_edge.runtime.cells import as_cell
from nnpp_edge.runtime.deadline import Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.state import MapState, map_state
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
from nnpp_edge.runtime.planners.methods import Methods
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Source
from nnpp_edge.runtime.planners.query import Query, Work, problem_with
from nnpp_edge.runtime.planners.searchers import AStarSearcher, MendingSearcher, RegionMender
from nnpp_edge.runtime.region.learned import LearnedRegions, NetworkAnswer
from nnpp_edge.runtime.search.astar import Search
from nnpp_edge.runtime.tuning import CORRIDOR, LEARNED_CORRIDOR, REFINE_FROM, WIDENED_CORRIDOR
from tests import oracles

SHAPE = (120, 160)
QUERY = Query((4, 5), (110, 150))
LATE = QUERY._replace(deadline=Deadline.within(0.0))
EVERYWHERE = Region.everywhere(*SHAPE)
NO_WAY = Search.without_path(Status.NO_PATH, 3, 1.0)


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
    return map_state(Ground(cost))


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


class RecordingMethods(Methods):
    """Methods that note why the whole map is searched, and search regions by a `Recording`."""

    def __init__(self, state, answers=(), regions=None, ask_from=0):
        super().__init__(state, ask_from=ask_from)
        self.recording, self.sources = Recording(self.astar, answers), []
        self.regions = regions

    def search_map(self, query, work, source=Source.MAP):
        self.sources.append(source)
        return super().search_map(query, work, source)

    def search_briefly(self, query, work):
        self.sources.append("briefly")
        return super().search_briefly(query, work)


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

        return NetworkAnswer(0.25, EVERYWHERE), each()


def corridor_of(state, answers=()):
    methods = RecordingMethods(state, answers)
    return lambda query: methods.corridor(query, Work(), methods.recording), methods.recording, methods


def learned_of(state, regions, answers=(), ask_from=0):
    methods = RecordingMethods(state, answers, regions, ask_from)
    return lambda query: methods.network_region(query, Work(), methods.recording), methods.recording, methods


def test_astar_gives_up_after_its_limit_and_has_at_most_so_many_landmarks_of_which_the_first_are_goals(state):
    searcher = AStarSearcher(state)
    assert searcher.search(QUERY, Work(), None, limit=50).status is Status.TIMEOUT
    searcher.prepare(3, [QUERY.goal])
    with pytest.raises(InvalidQueryError, match="at most 8"):
        searcher.prepare(8, [QUERY.goal])
    assert searcher.landmarks.cells[0] == QUERY.goal and len(searcher.landmarks.cells) == 4


def test_a_mender_keeps_its_search_from_one_query_to_the_next_and_forgets_it_for_another_goal(state, cost):
    mender = RegionMender(state)
    works = [Work() for _ in range(3)]
    for work in works[:2]:
        mender.search(QUERY, work, EVERYWHERE)
        assert mender.knows_region(QUERY.goal) and not mender.knows_region(QUERY.start)
    cost[8:11, 9:12] = np.inf
    state.update(8, 9, cost[8:11, 9:12])
    found = mender.search(QUERY, works[2], None)
    assert oracles.path_cost(found.path, cost) == pytest.approx(optimum(cost), rel=1e-5)
    assert works[1].expansions == 0 < works[2].expansions < works[0].expansions / 2 and works[0].expansions > 100
    near = QUERY._replace(start=(5, 6))
    for cheaper, said in ((False, "mended: "), (True, "searched afresh: ")):
        if cheaper:
            state.update(60, 60, np.zeros((1, 1)))  # cheaper than its heuristic allows for
        work = Work()
        assert mender.worth_mending(near, work, EVERYWHERE) is not cheaper
        assert work.remark.startswith(said) and ("times or more" in work.remark) == cheaper
    mender.expect((100, 20))
    assert not mender.knows_region((100, 20)) and not mender.knows_region(QUERY.goal)


@pytest.mark.parametrize("always", [False, True])
def test_a_mending_searcher_mends_or_searches_afresh(state, always):
    mender = RegionMender(state)
    searcher, works = MendingSearcher(mender, AStarSearcher(state), always=always), [Work(), Work()]
    for work in works:
        assert searcher.search(QUERY, work, EVERYWHERE).status is Status.OK
    assert mender.knows_region(QUERY.goal) == always == (works[1].expansions == 0)
    assert [bool(work.remark) for work in works] == [not always] * 2
    at_goal = searcher.search(Query(QUERY.goal, QUERY.goal), Work(), EVERYWHERE)
    assert at_goal.path.tolist() == [list(QUERY.goal)]


def test_the_exact_planner_finds_the_optimum_and_says_why_it_searched(state, cost):
    methods, work = Methods(state), Work()
    work.remark = "left by another"
    found = methods.search_map(QUERY, work, Source.FALLBACK)
    assert (found.source, found.region, work.remark) == (Source.FALLBACK, None, "")
    assert found.cost == pytest.approx(optimum(cost), rel=1e-5) == found.lower_bound
    assert found.suffices(QUERY._replace(epsilon=0.0))
    near = QUERY._replace(goal=(20, 22))
    assert methods.search_briefly(near, work).cost == pytest.approx(methods.search_map(near, work).cost)


def test_a_descent_hands_its_searcher_a_corridor_around_the_coarse_path_if_there_is_one(state):
    astar = AStarSearcher(state)
    recording, descent = Recording(astar), CoarseToFine(state, astar.workspace)
    for width in (CORRIDOR, WIDENED_CORRIDOR):
        search, region = descent.descend(QUERY, Work(), recording, 1, None, width)
        assert search.status is Status.OK and region.mask()[tuple(search.path.T)].all()
    first, wider = (region.mask() for region in recording.regions)
    assert (first <= wider).all() and 0 < first.sum() < wider.sum() <= first.size
    everything = Region.everywhere(*descent.coarse_levels[0].grid.shape)
    descent.descend(QUERY, Work(), recording, 1, everything, CORRIDOR)
    np.testing.assert_array_equal(recording.regions[-1].mask(), first)
    found = descent.find(QUERY, Work(), recording, 0, EVERYWHERE, CORRIDOR, Source.WIDENED)
    assert (recording.areas[-1], found.source) == (120 * 160, Source.WIDENED)
    assert descent.descend(QUERY, Work(), Recording(astar, [NO_WAY]), 1, None, CORRIDOR) is None
    state.update(60, 0, np.full((1, 160), np.inf))
    unasked = Recording(astar)
    with pytest.raises(OutOfTimeError):
        descent.find(LATE, Work(), unasked, 1, None, CORRIDOR, Source.REGION)
    assert descent.find(QUERY, Work(), unasked, 1, None, CORRIDOR, Source.REGION) is None
    assert unasked.areas == []  # the coarse level has no way


def test_a_corridor_is_widened_then_given_up_for_the_map(state, cost):
    for failures, source in enumerate((Source.REGION, Source.WIDENED, Source.FALLBACK)):
        planner, recording, exact = corridor_of(state, [NO_WAY] * failures)
        found = planner(QUERY)
        assert found.source is source and (found.region is None) == (failures == 2)
        assert recording.areas == sorted(recording.areas) and len(recording.areas) == min(failures + 1, 2)
        assert exact.sources == [Source.FALLBACK] * (failures == 2)
        assert found.cost >= optimum(cost) * (1 - 1e-5)
    planner, recording, exact = corridor_of(state)  # until the path is good enough
    assert planner(QUERY._replace(epsilon=0.0)).cost == pytest.approx(optimum(cost), rel=1e-5)
    assert exact.sources == [Source.FALLBACK] and len(recording.areas) == 2
    assert planner(QUERY._replace(epsilon=9.0)).source is Source.REGION and len(recording.areas) == 3
    planner, recording, exact = corridor_of(state, [Search.without_path(Status.TIMEOUT)])  # nor without time
    assert planner(QUERY).search.status is Status.TIMEOUT
    assert (len(recording.areas), exact.sources) == (1, [])


def test_learned_regions_are_searched_in_turn_and_then_the_map(state, cost):
    assert max(SHAPE) < REFINE_FROM
    for failures, source in enumerate((Source.REGION, Source.WIDENED, Source.WIDENED, Source.FALLBACK)):
        regions = GivenRegions(EVERYWHERE, EVERYWHERE, EVERYWHERE)
        planner, recording, exact = learned_of(state, regions, [NO_WAY] * failures)
        found = planner(QUERY)
        assert (found.source, found.threshold) == (source, 0.25)
        assert found.network_region is not None
        assert found.cost == pytest.approx(optimum(cost), rel=1e-5)
        assert regions.taken == len(recording.areas) == min(failures + 1, 3)  # none is made before it is needed
        assert regions.asked == [(QUERY.start, QUERY.goal, SHAPE, 0)]
        assert exact.sources == [Source.FALLBACK] * (failures == 3)
    shape = (REFINE_FROM, 120)  # a larger map is searched on the coarsest level
    regions = GivenRegions(None)
    planner, recording, _ = learned_of(map_state(Ground(rough(shape))), regions)
    found = planner(QUERY._replace(goal=(110, 100)))
    assert regions.asked[0][2:] == ((REFINE_FROM // 4, 30), 1)
    assert found.search.status is Status.OK and recording.areas[0] < shape[0] * shape[1]


def test_near_goals_are_found_without_asking_the_network(state):
    regions = GivenRegions()
    planner, _, exact = learned_of(state, regions, ask_from=40)
    found = planner(Query((4, 5), (20, 30)))
    assert (found.source, exact.sources, regions.asked) == (Source.MAP, ["briefly"], [])
    assert math.isnan(found.threshold)
    planner(QUERY)
    assert exact.sources == ["briefly", Source.FALLBACK] and len(regions.asked) == 1


def test_a_networks_regions_widen_and_hold_start_and_goal(state, network):
    astar, level = AStarSearcher(state), state.pyramid.levels[1]
    descent, learned, work = CoarseToFine(state, astar.workspace), LearnedRegions(state, network), Work()
    learned.prepare(level, 1)
    answer, regions = learned.regions(*QUERY[:2], level, 1, descent.workspace(1), work)
    ends = tuple(np.array([QUERY.start, QUERY.goal]).T)
    assert 0.0 < answer.threshold <= 1.0 and answer.region.mask()[ends].all()
    masks = []
    for region in regions:
        masks.append(np.ones(level.grid.shape, bool) if region is None else region.mask())
        assert masks[-1][tuple(each // 4 for each in ends)].all()
        assert descent.find(QUERY, work, astar, 1, region, LEARNED_CORRIDOR, Source.REGION).search.status is Status.OK
    first, wider, whole = masks
    assert (first <= wider).all() and first.sum() < wider.sum() and whole.all()
    assert {"encode", "inference", "threshold"} <= set(work.timings_ms)


def test_a_late_query_does_not_wait_for_the_coarse_levels(cost, network, monkeypatch):
    monkeypatch.setattr(MapState, "pyramid", property(lambda _: pytest.fail("without a deadline")))
    for method in (Method.CORRIDOR, Method.NNPP, DynamicMethod.CORRIDOR_DSTAR, DynamicMethod.NNPP_DSTAR):
        with pytest.raises(OutOfTimeError):
            Methods(map_state(Ground(cost)), network, ask_from=0).find(method, LATE, Work())


def test_every_method_finds_a_path_that_costs_little_more_than_the_optimum(state, network, cost):
    methods, best = Methods(state, network), optimum(cost)
    for method in set(DynamicMethod) - {DynamicMethod.AUTO}:
        work = Work()
        found = methods.find(method, QUERY, work)
        assert found.search.status is Status.OK and best * (1 - 1e-5) <= found.cost <= 1.1 * best
        plan = found.plan(method.base, work, planner=method)
        assert (plan.planner, plan.method, plan.expansions) == (method, method.base, work.expansions)


def test_a_query_knows_its_distance_and_what_forbids_it(state):
    assert Query((3, 9), (7, 2)).apart == 7
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
