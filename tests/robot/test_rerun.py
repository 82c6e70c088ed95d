import importlib
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing, suppress

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
from nnpp_edge.runtime.errors import InvalidQueryError, MissingExtraError, OutputError
from nnpp_edge.runtime.map.state import map_state
from nnpp_edge.viz.picture import cost_picture

STATE = map_state(Ground(np.full((5, 5), 0.2, np.float32)))
PATH = np.array([[3, 4], [4, 5], [4, 6]], np.int32)


def read(path):
    """By rerun's own reader: {entity: {column: values}}."""
    chunks = pytest.importorskip("rerun.chunk").RrdReader(str(path)).stream()
    found = {}
    for chunk in chunks:
        columns = found.setdefault(chunk.entity_path, {})
        batch = chunk.to_record_batch()
        for name in set(batch.schema.names) - {
            "log_time",
            "time",
        }:  # nanoseconds, too fine for datetime
            columns.setdefault(name.rpartition(":")[2], []).extend(batch.column(name).to_pylist())
    return found


def test_a_recording_holds_map_path_robot_goal_and_latencies(tmp_path):
    cost = np.linspace(0.0, 0.9, 20 * 30, dtype=np.float32).reshape(20, 30)
    cost[4, 4] = np.inf
    state = map_state(Ground(cost))
    with closing(RerunSink(tmp_path / "loop.rrd", state, map_every_s=0.0)) as sink:
        sink.record(Pose(3.25, 4.5))
        sink.record(Goal(7, 8))
        sink.record(MapPatch(2, 3, cost=np.zeros((4, 5))))
        for tick in (1, 2):
            sink.publish(PathMessage(tick, Status.OK, Origin.FULL, PATH, cost=2.0, planning_ms=1.5))
        state.update(0, 0, np.array([[1.0]]))
        sink.publish(
            PathMessage(3, Status.NO_PATH, Origin.NONE, reason="walled in", planning_ms=4.0)
        )
        sink.publish(
            StatusMessage(
                3, Status.NO_PATH, "how it is", Counters(tick_ms={"p99": 2.5}, rss_bytes=10**7)
            )
        )
        sink.record(Pose(3.5, 4.5))
    found = read(tmp_path / "loop.rrd")
    assert found["/map/path"]["tick"] == [1, 2, 3]
    first, second, none = found["/map/path"]["strips"]
    assert first == second == [[[4.5, 3.5], [5.5, 4.5], [6.5, 4.5]]] and not none
    assert found["/map/robot"]["positions"] == [[[4.5, 3.25]], [[4.5, 3.5]]]
    assert found["/map/robot"]["tick"] == [1, 4], "inputs belong to the tick that follows"
    assert found["/map/goal"]["tick"] == found["/map/patch"]["tick"] == [1]
    assert found["/map/goal"]["positions"] == [[[8.5, 7.5]]]
    assert found["/planning_ms"]["scalars"] == [[1.5], [1.5], [4.0]]
    assert found["/cost"]["scalars"] == [[2.0], [2.0]]
    assert found["/tick_ms/p99"]["scalars"] == [[2.5]]
    assert found["/memory_mb"]["scalars"] == [[10.0]]
    assert found["/status"]["text"] == [
        ["OK by full"],
        ["NO_PATH by none: walled in"],
        ["how it is"],
    ]
    pictures = [
        np.frombuffer(bytes(p[0]), np.uint8).reshape(20, 30, 3)
        for p in found["/map/cost"]["buffer"]
    ]
    assert len(pictures) == 2, "anew only where it has changed"
    np.testing.assert_array_equal(pictures[0], cost_picture(cost)[..., ::-1])
    np.testing.assert_array_equal(pictures[1], cost_picture(state.cost())[..., ::-1])


@pytest.mark.parametrize("radius", [None, 3.0])
def test_a_recording_holds_the_outline_of_the_body_and_of_arcs_the_headings(tmp_path, radius):
    body = Vehicle(length_m=2.0, width_m=1.0, clearance_m=0.3, turning_radius_m=radius)
    state = map_state(
        Ground.of_elevation(np.zeros((20, 300), np.float32), 0.5, cell_width_m=0.25, vehicle=body)
    )
    # arcs backwards
    line = np.array([(5, 5 + n) for n in range(250)], np.int32)
    ahead = -1.0 if radius else 1.0
    driven = {"states": (12,) * 250, "headings": (270.0,) * 250} if radius else {}
    with closing(RerunSink(tmp_path / "loop.rrd", state)) as sink:
        sink.record(Pose(5.5, 5.25, heading_deg=180.0))
        sink.publish(PathMessage(1, Status.OK, Origin.FULL, line, **driven))
        sink.publish(PathMessage(2, Status.NO_PATH, Origin.NONE))
    found = read(tmp_path / "loop.rrd")
    outlines, none = found["/map/body"]["strips"]
    corners = {(5.5 + x, 5.5 + y) for x in (-4.0, 4.0) for y in (-1.0, 1.0)}
    assert {tuple(corner) for corner in outlines[0]} == corners | {
        (5.5, 5.5),
        (5.5 + 4.0 * ahead, 5.5),
    } and not none
    assert found["/map/robot/heading"]["vectors"][0] == [pytest.approx([0.0, 1.0], abs=1e-6)]
    assert found["/map/robot/heading"]["origins"] == [[[5.25, 5.5]]]
    assert ("/map/headings" in found) == bool(radius)
    if radius:
        assert found["/map/headings"]["origins"] == [[[5.5 + 3 * n, 5.5] for n in range(84)], []]
        assert found["/map/headings"]["vectors"][0] == [pytest.approx([-2.0, 0.0], abs=1e-6)] * 84


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_a_viewer_elsewhere_is_shown_the_same(tmp_path):
    """One without a window: it keeps what it is sent."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    kept = tmp_path / "kept.rrd"
    command = [sys.executable, "-m", "rerun_cli", "--port", str(port), "--save", str(kept)]
    viewer = subprocess.Popen(command, start_new_session=True)  # it starts another
    try:
        for _ in range(1200):  # a first start reads a hundred megabytes
            with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
                break
            time.sleep(0.05)
        state = map_state(Ground(np.full((20, 30), 0.3)))
        with closing(RerunSink(f"rerun+http://127.0.0.1:{port}/proxy", state)) as sink:
            for tick in (1, 2):
                sink.publish(
                    PathMessage(tick, Status.OK, Origin.FULL, PATH, cost=2.0, planning_ms=1.5)
                )
        sizes = [-1, 0]
        while len(sizes) < 40 and (
            not sizes[-1] or sizes[-1] != sizes[-2]
        ):  # until nothing more comes
            time.sleep(0.5)
            sizes.append(kept.stat().st_size if kept.exists() else 0)
    finally:
        os.killpg(viewer.pid, signal.SIGKILL)
        viewer.wait(timeout=20)
    found = read(kept)
    assert found["/map/path"]["tick"] == [1, 2]
    assert len(found["/map/cost"]["buffer"]) == 1


def test_where_nothing_can_be_shown_it_is_one_line(tmp_path):
    with pytest.raises(InvalidQueryError, match=r"view must be here, rerun\+http.* got 'there'"):
        RerunSink("there", STATE)
    with pytest.raises(OutputError, match="no such file"):
        RerunSink(tmp_path / "missing" / "loop.rrd", STATE)
    with pytest.raises(OutputError, match="cannot write there"):
        RerunSink("rerun+http://no address", STATE)


def test_rerun_is_imported_only_when_it_is_used_and_without_it_the_error_names_the_extra(
    monkeypatch, tmp_path
):
    name = "nnpp_edge.robot.transports.rerun_view"
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.delitem(sys.modules, name)
    assert importlib.import_module(name).RerunSink is not RerunSink
    with pytest.raises(MissingExtraError, match=r"nnpp-edge\[viz\]"):
        RerunSink(tmp_path / "loop.rrd", STATE)
