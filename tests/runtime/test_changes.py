"""Whoever reads the log of a map's changes, at whatever times, is like one made afresh on the map as it is."""

import gc
from collections import deque
from contextlib import suppress
from functools import partial
from unittest.mock import patch as replaced

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from nnpp_edge.runtime import NetworkModel, Planner, Status
from nnpp_edge.runtime.cells import apart, enclosing
from nnpp_edge.runtime.deadline import Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.encoding import mean_difference
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map import state as state_module
from nnpp_edge.runtime.map.changes import MANY_NODES, Change, ChangeLog
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.planners import dynamic
from nnpp_edge.runtime.planners.dynamic import DynamicChooser
from nnpp_edge.runtime.planners.methods import Methods
from nnpp_edge.runtime.planners.plan import DynamicMethod
from nnpp_edge.runtime.planners.query import Query, Work
from nnpp_edge.runtime.planners.searchers import RegionMender
from nnpp_edge.runtime.planners.standing_path import Footing, StandingPath
from nnpp_edge.runtime.region.map_view import MapView
from nnpp_edge.runtime.search.dstar_lite import DStarLite
from nnpp_edge.runtime.tuning import MEND_SHARE, MEND_WITHIN, UNSEEN_CHANGE
from tests import oracles
from tests.strategies import random_cell, random_costs, random_patch, state_of

CLOSE = {"rel": 1e-5, "abs": 1e-5}
MEND_FROM = 12
"""Cells to the goal from which on the chooser may mend, here."""


class ChangingMap:
    """A map that is patched, and one reader of each kind on it; each method reads one and holds it against a new one.

    The log merges all but a few changes. `unmerged` is a map that is patched alike, whose log holds every change.
    """

    def __init__(self, rng, shape, step_cost, corner_cutting, most, networks):
        self.rng, self.step_cost, self.corner_cutting, self.most = rng, step_cost, corner_cutting, most
        self.network, self.network_in_parts = networks
        self.cost = random_costs(rng, shape, step_cost, blocked=0.15)
        self.goal, self.start = self.cell(), self.cell()
        with replaced.object(state_module, "ChangeLog", partial(ChangeLog, most)):
            self.state = state_of(self.cost, step_cost, corner_cutting)
        self.unmerged = state_of(self.cost, step_cost, corner_cutting)
        self.dstar, self.mender = DStarLite(self.state, self.goal), RegionMender(self.state)
        self.view = MapView(self.state, self.network)
        self.view_in_parts = MapView(self.state, self.network_in_parts, UNSEEN_CHANGE)
        self.path, self.unmerged_path = StandingPath(self.state), StandingPath(self.unmerged)
        self.chooser_path = StandingPath(self.state)
        self.chooser = DynamicChooser(Methods(self.state, self.network), self.chooser_path)
        self.since_answer = []
        self.weighing = self.state.log.reader(keeps_old_weights=True)
        self.at_last = self.state.grid.map().copy()

    def afresh(self):
        """A map state made now; its bounds are those of the old one, which may be wider than need be."""
        state = state_of(self.cost, self.step_cost, self.corner_cutting)
        state.grid.set_bounds(self.state.grid.least, self.state.grid.greatest)
        return state

    def cell(self):
        return random_cell(self.rng, self.cost.shape)

    def passable(self, *cells):
        return all(np.isfinite(self.cost[cell]) for cell in cells)

    def optimum(self, start):
        """By Dijkstra, on the costs alone."""
        if not self.passable(start, self.goal):
            return np.inf
        return oracles.dijkstra(self.cost, start, self.step_cost, self.corner_cutting)[self.goal]

    def check_path(self, path, start):
        """It leads from start to goal, and costs what the map says; its cost."""
        assert oracles.path_problem(path, self.cost, start, self.goal, self.corner_cutting) == ""
        cost = self.state.grid.costs_of(path)[0]
        assert cost == pytest.approx(oracles.path_cost(path, self.cost, self.step_cost), **CLOSE)
        return cost

    # Changes

    def patch_part(self):
        self.put(*random_patch(self.rng, self.cost, self.step_cost))

    def patch_with_extremes(self):
        """Weights below and above all so far: in the `length` model all that is relative to them is out of date."""
        row, col, patch = random_patch(self.rng, self.cost, self.step_cost)
        finite = self.cost[np.isfinite(self.cost)]
        least, greatest = (finite.min(), finite.max()) if finite.size else (0.4, 0.5)
        greatest = min(greatest * 1.5, 0.99) if self.step_cost == "paper" else greatest * 1.5
        self.put(row, col, np.where(self.rng.random(patch.shape) < 0.5, least / 2, greatest).astype(np.float32))

    def patch_whole(self):
        cost = self.cost * np.float32(self.rng.choice([0.5, 1.0, 1.2]))
        if self.step_cost == "paper":
            cost[cost >= 1.0] = np.inf
        cost[self.rng.random(cost.shape) < 0.05] = 0.3
        self.put(0, 0, cost)

    def put(self, row, col, patch):
        before = self.state.grid.map().copy()
        change = self.state.update(row, col, patch)
        self.unmerged.update(row, col, patch)
        self.unmerged_path.check(self.start)
        self.cost[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
        assert change.cells == (self.state.grid.map() != before).sum()
        if change.cells:
            self.since_answer.append(change)

    def move(self):
        self.start = self.cell()

    # Readers

    def read_dstar(self):
        if self.rng.random() < 0.2:
            self.dstar.plan(self.start, deadline=Deadline.within(0.0))
        found, optimum = self.dstar.plan(self.start), self.optimum(self.start)
        assert (found.status is Status.OK) == np.isfinite(optimum)
        if found.status is Status.OK:
            assert self.check_path(found.path, self.start) == pytest.approx(optimum, **CLOSE)

    def region(self):
        """At times everywhere, else some blocks and those of start and goal."""
        blocks = [2 * -(-cells // FACTOR) for cells in self.cost.shape]
        bitmap = (self.rng.random(blocks) < self.rng.choice([0.6, 0.9, 1.0])).astype(np.int32)
        lookup = self.state.pyramid.levels[0].quarters
        for cell in (self.start, self.goal):
            bitmap[lookup[0][cell[0]], lookup[1][cell[1]]] = 1
        return Region(bitmap, *lookup)

    def read_mender(self):
        """What it knows may hold more than the region, never less."""
        query, region = Query(self.start, self.goal), self.region()
        if not self.passable(*query[:2]) or query.apart == 0:
            return
        if self.rng.random() < 0.5:
            self.mender.worth_mending(query, Work(), region)
        if self.rng.random() < 0.2:
            with suppress(OutOfTimeError):
                self.mender.search(query._replace(deadline=Deadline.within(0.0)), Work(), region)
        found, optimum = self.mender.search(query, Work(), region), self.optimum(self.start)
        again = self.mender.search(query, Work(), None)
        new = RegionMender(self.afresh()).search(query, Work(), region)
        inside = self.state.grid.costs_of(new.path)[0]
        assert np.isfinite(inside) <= (found.status is Status.OK) <= np.isfinite(optimum)
        if found.status is Status.OK:
            cost = self.check_path(found.path, self.start)
            assert optimum - 1e-4 <= cost <= inside * (1.0 + 1e-5) + 1e-5
            assert self.state.grid.costs_of(again.path)[0] == pytest.approx(cost, **CLOSE)
            if region.blocks().all():
                assert cost == pytest.approx(optimum, **CLOSE)

    def read_view(self):
        new = MapView(self.afresh(), self.network)
        for view in (self.view, new):
            view.show(self.start, self.goal)
        assert self.view.window == new.window
        np.testing.assert_allclose(self.view.planes, new.planes, atol=1e-6)

    def read_view_in_parts(self):
        """It may differ from a new one by a share of the window, until it is refreshed."""
        view, new = self.view_in_parts, MapView(self.afresh(), self.network_in_parts)
        for each in (view, new):
            each.show(self.start, self.goal)
        if view.window == new.window:
            shown, wanted = (each.network.inputs["map"][0] for each in (view, new))
            cells = new.frame.inner[0] * new.frame.inner[1]
            assert mean_difference(shown, wanted) * view.size**2 <= (UNSEEN_CHANGE + 1e-4) * cells
            view.refresh()
            np.testing.assert_allclose(shown, wanted, atol=1e-6)

    def stand_on_path(self):
        """Follow the optimal path from here."""
        if np.isfinite(self.optimum(self.start)):
            planner = Planner(self.cost, step_cost=self.step_cost, corner_cutting=self.corner_cutting)
            plan = planner.plan(self.start, self.goal, method="astar")
            for path in (self.path, self.unmerged_path):
                path.set(plan)

    def read_standing_path(self):
        """Its bounds are those of one that has read each change at once, and they hold."""
        if self.path.plan is None:
            assert self.path.check(self.start).footing is Footing.NONE
            return
        path = self.path.plan.path
        at = tuple(int(x) for x in path[int(self.rng.integers(len(path)))])
        found, wanted = self.path.check(at), self.unmerged_path.check(at)
        assert (found.footing, found.index, found.blocked_at) == (wanted.footing, wanted.index, wanted.blocked_at)
        assert (found.cost, found.lower_bound, found.floor) == pytest.approx(
            (wanted.cost, wanted.lower_bound, wanted.floor), **CLOSE
        )
        rest, goal = path[found.index :], self.goal
        problem = oracles.path_problem(rest, self.cost, at, path[-1], self.corner_cutting)
        assert found.valid == (problem == "")
        optimum = self.optimum(at)
        slack = 2e-5 * (self.path.plan.cost + 1.0)
        if np.isfinite(optimum) and tuple(path[-1]) == goal:
            assert max(found.lower_bound, found.floor) <= optimum + slack
            assert not found.valid or found.cost <= found.bound * optimum + slack

    def read_chooser(self):
        """It mends only where all that has changed since its last answer is little and near, merged or not."""
        query, work = Query(self.start, self.goal), Work()
        if not self.passable(*query[:2]):
            return
        reach, merged = MEND_WITHIN * query.apart, len(self.since_answer) > self.most
        small = sum(change.cells for change in self.since_answer) <= MEND_SHARE * self.cost.size * 16
        near = all(apart(c.part, self.start) + max(c.part[2:]) <= reach for c in self.since_answer)
        worth = self.chooser_path.plan is not None and query.apart >= MEND_FROM and small and near
        values = {"MEND_FROM": MEND_FROM, "NEAR": 0, "MEND_SHARE": MEND_SHARE * 16}
        with replaced.multiple(dynamic, **values):
            found, method, _ = self.chooser.find(query, work)
        assert (method is DynamicMethod.CORRIDOR_DSTAR) <= worth
        if not merged:
            assert (method is DynamicMethod.CORRIDOR_DSTAR) == worth
        optimum = self.optimum(self.start)
        assert (found.search.status is Status.OK) == np.isfinite(optimum)
        if found.search.status is Status.OK:
            assert self.check_path(found.search.path, self.start) >= optimum * (1 - 1e-5) - 1e-5
            self.chooser_path.set(found.plan(method, work))
            self.chooser.answered()
            self.since_answer.clear()

    def read_old_weights(self):
        """Changes cover every cell that is another one; of several the first has its weight at the last reading."""
        before, now, first = self.at_last, self.state.grid.map().copy(), {}
        changes = self.weighing.read()
        for change in changes:
            for node, old in zip(change.nodes.tolist(), change.old_weights.tolist(), strict=True):
                first.setdefault(self.state.grid.cell(node), old)
        assert {cell: before[cell] for cell in first} == first
        differ = {tuple(cell) for cell in np.argwhere(before != now).tolist()}
        assert differ <= first.keys()
        assert all(any(apart(change.part, cell) == 0 for change in changes) for cell in differ)
        assert any(change.cheaper for change in changes) >= (now < before).any()
        assert self.weighing.behind == 0 and not self.weighing.read()
        self.at_last = now


PATCHES = ("patch_part", "patch_part", "patch_part", "patch_with_extremes", "patch_whole")
READERS = tuple(name for name in vars(ChangingMap) if name.startswith("read_"))
STEPS = st.lists(st.sampled_from((*PATCHES * 3, *READERS, "move", "stand_on_path")), max_size=40)


@pytest.fixture(scope="module")
def networks(network):
    """One that sees map and query at once, and one that sees the map first."""
    return network, NetworkModel("edge")


@given(
    steps=STEPS,
    shape=st.sampled_from([(7, 12), (24, 31), (33, 150)]),
    step_cost=st.sampled_from(["paper", "length"]),
    corner_cutting=st.booleans(),
    most=st.sampled_from([1, 2, 5, 64]),
    seed=st.integers(0, 2**32),
)
@example([*["stand_on_path", *["patch_part"] * 9, "patch_whole"] * 2, *READERS], (24, 31), "length", True, 2, 5)
@example([*["patch_with_extremes", "move"] * 6, *READERS], (33, 150), "length", False, 1, 6)
@example(["read_chooser", *["patch_part", "read_chooser", "read_mender"] * 12], (33, 150), "paper", True, 64, 7)
def test_every_reader_of_the_log_is_like_one_made_afresh(
    networks, steps, shape, step_cost, corner_cutting, most, seed
):
    world = ChangingMap(np.random.default_rng(seed), shape, step_cost, corner_cutting, most, networks)
    for step in (*steps, *READERS):
        getattr(world, step)()


# --- the log itself


def change_of(*nodes, old=1.0, row=0):
    """A change of one row of cells, by their columns, that all weighed the same."""
    part = (row, min(nodes), 1, max(nodes) - min(nodes) + 1)
    return Change(part, len(nodes), nodes=np.array(nodes, np.int32), old_weights=np.full(len(nodes), old, np.float32))


@given(st.integers(1, 6), st.lists(st.tuples(st.sampled_from("aaaaar"), st.integers(0, 30)), max_size=60))
def test_merged_changes_cover_all_that_they_were_made_of(most, steps):
    log = ChangeLog(most)
    reader, unread = log.reader(keeps_old_weights=True), []
    for number, (what, col) in enumerate(steps):
        if what == "a":
            change = change_of(col, old=float(number), row=number)
            unread.append(change._replace(cheaper=col % 9 == 0, rescaled=col % 11 == 0))
            log.append(unread[-1])
            assert len(reader.peek()) <= most
            continue
        assert reader.behind == len(unread) and log.reader().behind == 0
        changes, whole = reader.peek() if col % 3 == 0 else reader.read(), deque(unread)
        for change in changes:  # each covers exactly the next of those that were appended
            merged = [whole.popleft() for _ in range(change.cells)]
            assert change.part == enclosing([each.part for each in merged])
            np.testing.assert_array_equal(change.old_weights, [w for each in merged for w in each.old_weights])
            for flag in ("cheaper", "rescaled"):
                assert getattr(change, flag) == any(getattr(each, flag) for each in merged)
        assert not whole
        if col % 3:
            unread.clear()


def test_of_many_merged_nodes_each_is_kept_once_with_its_oldest_weight():
    log, nodes = ChangeLog(2), np.arange(MANY_NODES, dtype=np.int32)
    reader = log.reader(keeps_old_weights=True)
    for old in range(1, 8):
        weights = np.full(len(nodes), float(old))
        log.append(Change((0, 0, 1, len(nodes)), len(nodes), nodes=nodes, old_weights=weights))
    assert sum(len(change.nodes) for change in reader.peek()) <= 3 * len(nodes)
    first = np.zeros(len(nodes))
    for change in reversed(reader.read()):
        first[change.nodes] = change.old_weights
    assert (first == 1.0).all()


def test_old_weights_are_noted_only_for_readers_that_want_them():
    """Or a robot that computes its whole map anew each time would hold dozens of maps."""
    cost = np.random.default_rng(0).random((300, 300)).astype(np.float32) * 0.5
    state = state_of(cost)
    slow = state.log.reader()
    assert state.update(0, 0, cost + np.float32(0.1)).nodes.size == 0
    weights = state.log.reader(keeps_old_weights=True)
    for n in range(20):
        state.update(0, 0, cost if n % 2 == 0 else cost + np.float32(0.1))
        assert sum(len(change.nodes) for change in weights.read()) == cost.size
        assert not any(len(change.nodes) for change in slow.peek())
    assert state.update(0, 0, cost + np.float32(0.1)).cells == 0  # which is not written down
    assert (slow.behind, weights.behind) == (21, 0)
    del weights
    gc.collect()
    assert not state.log.keeps_old_weights


# --- the standing path, by hand


def standing_on(cost, start, goal, **options):
    """A standing path along the optimum, its plan, and what patches the map."""
    planner = Planner(cost, **options)
    path, plan = StandingPath(planner.state), planner.plan(start, goal, method="astar")
    path.set(plan)
    return path, plan, lambda row, col, patch: planner.update(row, col, np.array(patch, np.float32, ndmin=2))


def free(rows, cols):
    return np.full((rows, cols), 0.2, np.float32)


def test_changes_behind_the_robot_do_not_matter_and_off_its_path_it_stands_on_none():
    path, plan, put = standing_on(free(20, 60), (10, 0), (10, 59))
    put(10, 5, np.inf)
    assert (path.check((10, 0)).footing, path.check((10, 0)).blocked_at) == (Footing.BLOCKED, (10, 5))
    later = path.check((10, 20))
    assert later.valid and later.index == 20
    assert later.cost == pytest.approx(plan.cost * 39 / 59) and later.bound == pytest.approx(1.0, rel=1e-5)
    assert later.added == pytest.approx(0.0, abs=1e-4)
    assert path.check((3, 3)).footing is Footing.OFF_PATH
    path.forget()
    found = path.check((10, 0))
    assert (found.footing, found.valid, found.lower_bound) == (Footing.NONE, False, 0.0)


def test_only_a_path_to_the_goal_can_stand():
    cost = free(5, 5)
    cost[:, 2] = np.inf
    path, plan, put = standing_on(cost, (0, 0), (4, 0))
    with pytest.raises(InvalidQueryError, match="NO_PATH"):
        path.set(Planner(cost).plan((0, 0), (4, 4), method="astar"))
    put(2, 0, [[np.inf, np.inf]])
    with pytest.raises(InvalidQueryError, match="walkable"):
        path.set(plan)


def test_costs_that_rise_leave_the_bound_and_what_is_far_off_saves_nothing():
    path, plan, put = standing_on(free(20, 60), (10, 0), (10, 59))
    put(0, 30, 0.15)
    assert path.check((10, 0)).added < 0.1 * plan.cost  # one cell's saving at most
    put(0, 30, 0.2)  # what was is what counts, not the order of changes
    assert path.check((10, 0)).added == pytest.approx(0.0, abs=1e-3)
    put(5, 0, np.full((10, 60), 0.3))  # other rows stay cheap, as the octile distance goes by the cheapest cell
    found = path.check((10, 0))
    assert found.lower_bound == pytest.approx(plan.cost, rel=1e-3)
    assert found.added == pytest.approx(0.1 * 2 * 2.805 * 59, rel=1e-3)
    path.set(plan)  # which forgets what changed before it
    assert path.check((10, 0)).added == pytest.approx(0.0, abs=1e-6)
    cost = free(30, 60)
    cost[29, 0] = np.inf
    path, _, put = standing_on(cost, (0, 0), (0, 59))
    put(29, 0, 0.2)  # opened, but the way over it costs more
    assert path.check((0, 0)).added == 0.0
