"""What rerun's own reader finds in a recording, and where nothing can be shown."""

from contextlib import closing

import numpy as np
import pytest

pytest.importorskip("rerun")

from nnpp_edge.robot.transports.rerun_view import RerunSink
from nnpp_edge.runtime import (
    Counters,
    Goal,
    Ground,
    MapPatch,
    Origin,
    PathMessage,
    Pose,
    Status,
    StatusMessage,
    Vehicle,
)
from nnpp_edge.runtime.errors import InvalidQueryError, OutputError
from nnpp_edge.runtime.map.state import map_state
from nnpp_edge.viz.picture import cost_picture

PATH = np.array([[3, 4], [4, 5], [4, 6]], np.int32)


def read(path):
    """By rerun's own reader: {entity: {column: values}}."""
    chunks = pytest.importorskip("rerun.chunk").RrdReader(str(path)).stream()
    found = {}
    for chunk in chunks:
        columns = found.setdefault(chunk.entity_path, {})
        batch = chunk.to_record_batch()
        for name in set(batch.schema.names) - {"log_time"}:  # too fine for datetime
            columns.setdefault(name.rpartition(":")[2], []).extend(batch.column(name).to_pylist())
    return found


@pytest.fixture
def state():
    cost = np.linspace(0.0, 0.9, 20 * 30, dtype=np.float32).reshape(20, 30)
    cost[4, 4] = np.inf
    return map_state(Ground(cost))


def answer(tick):
    return PathMessage(tick, Status.OK, Origin.FULL, PATH, cost=2.0, planning_ms=1.5)


def test_a_recording_holds_map_path_robot_goal_and_times(tmp_path, state):
    first_cost = state.cost()
    with closing(RerunSink(str(tmp_path / "loop.rrd"), state)) as sink:
        sink.record(Pose(3.25, 4.5))
        sink.record(Goal(7, 8))
        sink.record(MapPatch(2, 3, cost=np.zeros((4, 5))))
        for tick in (1, 2):
            sink.publish(answer(tick))
        state.update(0, 0, np.array([[1.0]]))
        sink.publish(PathMessage(3, Status.NO_PATH, Origin.NONE, planning_ms=4.0))
        for text in ("how it is", "as before"):
            sink.publish(StatusMessage(3, Status.NO_PATH, text, Counters()))
        sink.record(Pose(3.5, 4.5))
    found = read(tmp_path / "loop.rrd")
    assert found["/map/path"]["tick"] == [1, 2, 3]
    first, second, none = found["/map/path"]["strips"]
    assert first == second == [[[4.5, 3.5], [5.5, 4.5], [6.5, 4.5]]] and not none
    assert found["/map/robot"]["positions"] == [[[4.5, 3.25]], [[4.5, 3.5]]]
    assert found["/map/robot"]["tick"] == [1, 4], "inputs belong to the tick that follows"
    assert found["/map/goal"]["positions"] == [[[8.5, 7.5]]]
    assert found["/planning_ms"]["scalars"] == [[1.5], [1.5], [4.0]]
    assert found["/status"]["text"] == [["how it is"], ["as before"]]
    shown = [np.frombuffer(bytes(each[0]), np.uint8) for each in found["/map/cost"]["buffer"]]
    assert len(shown) == 2, "anew only where it has changed"
    for picture, cost in zip(shown, (first_cost, state.cost()), strict=True):
        np.testing.assert_array_equal(picture.reshape(20, 30, 3), cost_picture(cost))


def test_the_outline_of_a_body_lies_along_its_path(tmp_path):
    body = Vehicle(length_m=2.0, width_m=1.0, clearance_m=0.3)
    level = np.zeros((20, 300), np.float32)
    state = map_state(Ground.of_elevation(level, 0.5, cell_width_m=0.25, vehicle=body))
    line = np.array([(5, 5 + n) for n in range(250)], np.int32)
    with closing(RerunSink(str(tmp_path / "loop.rrd"), state)) as sink:
        sink.publish(PathMessage(1, Status.OK, Origin.FULL, line))
        driven = {"states": (12,) * 250, "headings": (270.0,) * 250}
        sink.publish(PathMessage(2, Status.OK, Origin.FULL, line, **driven))
        sink.publish(PathMessage(3, Status.NO_PATH, Origin.NONE))
    outlines, backwards, none = read(tmp_path / "loop.rrd")["/map/body"]["strips"]
    assert (outlines[0][0], backwards[0][0]) == ([9.5, 5.5], [1.5, 5.5]) and not none


@pytest.mark.parametrize(
    ("where", "error", "words"),
    [
        ("there", InvalidQueryError, r"view must be here, rerun\+http.* got 'there'"),
        ("missing/loop.rrd", OutputError, "no such file"),
        ("rerun+http://no address", OutputError, "cannot write there"),
    ],
)
def test_where_nothing_can_be_shown_one_line_says_so(state, where, error, words):
    with pytest.raises(error, match=words):
        RerunSink(where, state)
