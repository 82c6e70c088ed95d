import gc
from collections import deque

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime.cells import enclosing
from nnpp_edge.runtime.map.changes import MANY_NODES, Change, ChangeLog
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.step_cost import StepModel


def change_of(*nodes, old=1.0, row=0):
    """A change of one row of cells, by their columns, that all weighed the same."""
    part = (row, min(nodes), 1, max(nodes) - min(nodes) + 1)
    return Change(part, len(nodes), nodes=np.array(nodes, np.int32), old_weights=np.full(len(nodes), old, np.float32))


def kept(log):
    """All changes that the log still holds."""
    return log.since(0)


def test_changes_are_numbered_and_read_once_in_order():
    log = ChangeLog()
    assert log.version == 0
    early = log.reader()
    assert [log.append(change_of(n)) for n in range(3)] == [1, 2, 3]
    late = log.reader()
    assert (early.behind, late.behind) == (3, 0)
    assert [change.part[1] for change in early.peek()] == [0, 1, 2]
    assert [change.part[1] for change in early.read()] == [0, 1, 2]
    assert list(early.read()) == list(early.peek()) == list(late.read()) == []
    log.append(change_of(7))
    assert (early.behind, early.version, log.version) == (1, 3, 4)
    early.skip()
    assert (early.behind, late.behind) == (0, 1)
    assert [change.part[1] for change in late.read()] == [7]


@given(st.integers(1, 6), st.lists(st.tuples(st.sampled_from("aaaaa012"), st.integers(0, 30)), max_size=60))
def test_merging_never_crosses_a_readers_place_and_covers_all_that_it_merges(most, steps):
    log = ChangeLog(most)
    readers, unread = [log.reader(), log.reader(), log.reader()], [[], [], []]
    for number, (what, col) in enumerate(steps):
        if what == "a":
            change = change_of(col, old=float(number), row=number)._replace(
                cheaper=col % 9 == 0, rescaled=col % 11 == 0
            )
            assert log.append(change) == log.version
            for each in unread:
                each.append(change)
            assert len(kept(log)) <= most + len(readers)
            continue
        reader, appended = readers[int(what)], unread[int(what)]
        assert reader.behind == len(appended)
        changes = reader.peek() if col % 3 == 0 else reader.read()
        assert sum(change.cells for change in changes) == sum(change.cells for change in appended)
        for flag in ("cheaper", "rescaled"):
            assert any(getattr(c, flag) for c in changes) == any(getattr(c, flag) for c in appended)
        whole = deque(appended)
        for change in changes:  # each covers exactly the next of those that were appended
            merged = [whole.popleft() for _ in range(change.cells)]
            assert change.part == enclosing([each.part for each in merged])
            np.testing.assert_array_equal(change.old_weights, [w for each in merged for w in each.old_weights])
        assert not whole
        if col % 3:
            appended.clear()


def test_of_many_merged_nodes_each_is_kept_once_with_its_oldest_weight():
    log, nodes = ChangeLog(2), np.arange(MANY_NODES, dtype=np.int32)
    reader = log.reader(keeps_old_weights=True)
    for old in range(1, 8):
        log.append(
            Change((0, 0, 1, len(nodes)), len(nodes), nodes=nodes, old_weights=np.full(len(nodes), float(old)))
        )
    assert sum(len(change.nodes) for change in kept(log)) <= 3 * len(nodes)
    first = np.zeros(len(nodes))
    for change in reversed(reader.read()):
        first[change.nodes] = change.old_weights
    assert (first == 1.0).all()


def test_old_weights_that_have_been_read_are_not_held_for_readers_of_none():
    """Or a robot that computes its whole map anew each time would hold dozens of maps."""
    cost = np.random.default_rng(0).random((300, 300)).astype(np.float32) * 0.5
    state = MapState(cost, StepModel.of("paper"))
    slow, weights = state.log.reader(), state.log.reader(keeps_old_weights=True)
    for n in range(20):
        state.update(0, 0, cost if n % 2 else cost + np.float32(0.1))
        assert sum(len(change.nodes) for change in weights.read()) == cost.size
        assert sum(len(change.nodes) for change in kept(state.log)) <= 2 * cost.size
    assert slow.behind == 20


def test_old_weights_are_noted_only_where_a_reader_wants_them():
    state, patch = MapState(np.full((8, 9), 0.5), StepModel.of("paper")), np.full((2, 3), 0.25)
    plain = state.log.reader()
    assert (state.update(1, 2, patch).nodes.size, plain.read()[0].nodes.size) == (0, 0)
    wanting = state.log.reader(keeps_old_weights=True)
    assert state.update(1, 2, 2 * patch).cells == 6
    (change,) = wanting.read()
    assert change.nodes.tolist() == [state.grid.node(row, col) for row in (1, 2) for col in (2, 3, 4)]
    np.testing.assert_array_equal(change.old_weights, np.full(6, 0.25 * state.grid.model.scale, np.float32))
    version = state.log.version
    state.update(1, 2, 2 * patch)  # what changes nothing is not written down
    assert (wanting.behind, state.log.version) == (0, version)


def test_the_log_holds_few_changes_merges_them_only_without_room_and_forgets_readers_that_are_gone():
    log = ChangeLog(8)
    slow, fast = log.reader(keeps_old_weights=True), log.reader()
    for n in range(1000):
        log.append(change_of(n % 50))
        if n % 2:
            fast.skip()
        assert len(kept(log)) <= 8 + 2 and (log.merged == 0) == (n < 8)
    assert slow.behind == 1000 and log.keeps_old_weights
    assert sum(change.cells for change in slow.peek()) == 1000
    del slow
    gc.collect()
    assert not log.keeps_old_weights
    merged = log.merged
    for n in range(50):
        log.append(change_of(n))
        assert [change.part[1] for change in fast.read()][-1] == n
        assert len(kept(log)) <= 8
    assert log.merged == merged
