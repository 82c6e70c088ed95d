import gc
from collections import deque

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime.cells import enclosing
from nnpp_edge.runtime.map.changes import MANY_NODES, Change, ChangeLog
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import map_state


def change_of(*nodes, old=1.0, row=0):
    """A change of one row of cells, by their columns, that all weighed the same."""
    part = (row, min(nodes), 1, max(nodes) - min(nodes) + 1)
    return Change(part, len(nodes), nodes=np.array(nodes, np.int32), old_weights=np.full(len(nodes), old, np.float32))


def test_changes_are_numbered_and_read_once_in_order():
    log = ChangeLog()
    early = log.reader()
    for n in range(3):
        log.append(change_of(n))
    late = log.reader()
    assert (early.behind, late.behind, log.version) == (3, 0, 3)
    assert [change.part[1] for change in early.peek()] == [0, 1, 2]
    assert [change.part[1] for change in early.read()] == [0, 1, 2]
    assert list(early.read()) == list(early.peek()) == list(late.read()) == []
    log.append(change_of(7))
    early.skip()
    assert (early.behind, late.behind) == (0, 1)
    assert [change.part[1] for change in late.read()] == [7]


@given(st.integers(1, 6), st.lists(st.tuples(st.sampled_from("aaaaar"), st.integers(0, 30)), max_size=60))
def test_merged_changes_cover_all_that_they_were_made_of(most, steps):
    log = ChangeLog(most)
    reader, unread = log.reader(keeps_old_weights=True), []
    for number, (what, col) in enumerate(steps):
        if what == "a":
            unread.append(
                change_of(col, old=float(number), row=number)._replace(cheaper=col % 9 == 0, rescaled=col % 11 == 0)
            )
            log.append(unread[-1])
            assert len(reader.peek()) <= most
            continue
        assert reader.behind == len(unread)
        changes = reader.peek() if col % 3 == 0 else reader.read()
        whole = deque(unread)
        for change in changes:  # each covers exactly the next of those that were appended
            merged = [whole.popleft() for _ in range(change.cells)]
            assert change.part == enclosing([each.part for each in merged])
            for flag in ("cheaper", "rescaled"):
                assert getattr(change, flag) == any(getattr(each, flag) for each in merged)
            np.testing.assert_array_equal(change.old_weights, [w for each in merged for w in each.old_weights])
        assert not whole
        if col % 3:
            unread.clear()


def test_of_many_merged_nodes_each_is_kept_once_with_its_oldest_weight():
    log, nodes = ChangeLog(2), np.arange(MANY_NODES, dtype=np.int32)
    reader = log.reader(keeps_old_weights=True)
    for old in range(1, 8):
        log.append(
            Change((0, 0, 1, len(nodes)), len(nodes), nodes=nodes, old_weights=np.full(len(nodes), float(old)))
        )
    assert sum(len(change.nodes) for change in reader.peek()) <= 3 * len(nodes)
    first = np.zeros(len(nodes))
    for change in reversed(reader.read()):
        first[change.nodes] = change.old_weights
    assert (first == 1.0).all()


def test_old_weights_that_have_been_read_are_not_held_for_readers_of_none():
    """Or a robot that computes its whole map anew each time would hold dozens of maps."""
    cost = np.random.default_rng(0).random((300, 300)).astype(np.float32) * 0.5
    state = map_state(Ground(cost))
    slow, weights = state.log.reader(), state.log.reader(keeps_old_weights=True)
    for n in range(20):
        state.update(0, 0, cost if n % 2 else cost + np.float32(0.1))
        assert sum(len(change.nodes) for change in weights.read()) == cost.size
        assert not any(len(change.nodes) for change in slow.peek())
    assert slow.behind == 20


def test_old_weights_are_noted_only_where_a_reader_wants_them():
    state, patch = map_state(Ground(np.full((8, 9), 0.5))), np.full((2, 3), 0.25)
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


def test_few_changes_wait_for_a_reader_and_none_for_one_that_is_gone():
    log = ChangeLog(8)
    slow, fast = log.reader(keeps_old_weights=True), log.reader()
    for n in range(1000):
        log.append(change_of(n % 50))
        assert [change.part[1] for change in fast.read()] == [n % 50]
        assert len(slow.peek()) <= 8
    assert slow.behind == 1000 and log.keeps_old_weights
    assert sum(change.cells for change in slow.peek()) == 1000
    del slow
    gc.collect()
    assert not log.keeps_old_weights
