"""The node against ROS 2 itself: `nnpp-edge ros` in one process, plain rclpy in another.

They meet on the loopback interface, in a domain of their own. Messages that are on no wheel
(grid_map_msgs, nav2_msgs) are built by `ros2_types`.
"""

import json
import math
import os
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

pytest.importorskip("rclpy")

from nav_msgs.srv import GetPlan

from nnpp_edge.robot.ros2.frames import PoseInFrame
from nnpp_edge.robot.ros2.questions import Questions
from nnpp_edge.robot.ros2.session import Session
from nnpp_edge.ros.maps import MapFrame
from nnpp_edge.runtime import Counters, DynamicPlanner, Ground, Navigator
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.messages import MapPatch, Pose, StatusMessage
from nnpp_edge.runtime.loop.settings import OnboardLoop
from tests.robot.conftest import wait_until
from tests.robot.ros2_types import built
from tests.robot.test_ros_maps import message as grid_map

ROOT = Path(__file__).parents[2]
TOPICS = {
    "plan": ("nav_msgs/msg/Path", "latched"),
    "plan_gears": ("std_msgs/msg/Int8MultiArray", "latched"),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", "default"),
}
DEFAULTS = {
    "map_file": "",
    "map_size_m": 0.0,
    "resolution": 0.1,
    "global_frame": "map",
    "vehicle": "",
    "radius_m": 0.0,
    "approach": False,
    "odom_timeout_s": 1.0,
    "method": "auto",
    "rate_hz": 17.0,
}


@pytest.fixture(scope="module")
def environment():
    """Of both processes: the loopback interface, a domain of their own, and the built messages."""
    return os.environ | {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "PYTHONPATH": str(built()),
    }


class Peer:
    """The other process: `send` has it publish or ask, `heard` is what it received."""

    def __init__(self, environment):
        self.heard = {}
        self.process = subprocess.Popen(
            [sys.executable, ROOT / "tests/robot/ros2_peer.py"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        self.wait("ready")
        for topic, (kind, qos) in TOPICS.items():
            self.send("listen", topic, kind, qos=qos)

    def _listen(self):
        for line in self.process.stdout:
            topic, message = json.loads(line)
            self.heard.setdefault(topic, []).append(message)

    def send(self, op, name, kind, **more):
        self.process.stdin.write(json.dumps({"op": op, "name": name, "kind": kind} | more) + "\n")
        self.process.stdin.flush()

    def wait(self, topic, holds=lambda message: True, patience_s=30.0):
        """The next message of a topic that is as wanted; those before it are passed over."""
        found = []

        def came():
            waiting = self.heard.get(topic, [])
            while waiting and not found:
                message = waiting.pop(0)
                if holds(message):
                    found.append(message)
            return found

        wait_until(came, patience_s)
        return found[0]

    def ask(self, name, kind, message=None, op="call"):
        """The answer of a service, or with ``act`` of an action."""
        self.heard.pop(name, None)
        self.send(op, name, kind, message=message or {})
        return self.wait(name)

    def close(self):
        self.process.stdin.close()
        self.process.wait(10.0)
        self._thread.join(5.0)
        self.process.stdout.close()


class Node:
    """The node's process, and the other through which it is spoken to."""

    def __init__(self, environment, peer, *arguments):
        self.peer = peer
        self.process = subprocess.Popen(
            [sys.executable, "-m", "nnpp_edge.cli.main", "ros", "--ros-args", *arguments],
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            cwd=ROOT,
        )
        self.lines = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        for line in self.process.stderr:
            self.lines.append(line)

    def said(self, words):
        wait_until(lambda: any(words in line for line in list(self.lines)))

    @property
    def state(self):
        answer = self.peer.ask("/nnpp_edge/get_state", "lifecycle_msgs/srv/GetState")
        return answer["current_state"]["label"]

    def change(self, transition):
        """Whether the transition, 1 configure, 2 clean up, 3 activate, 4 deactivate, succeeded."""
        kind = "lifecycle_msgs/srv/ChangeState"
        message = {"transition": {"id": transition}}
        return self.peer.ask("/nnpp_edge/change_state", kind, message)["success"]

    def set(self, **values):
        """Set parameters; why one was refused, or nothing."""
        kinds = {bool: (1, "bool"), int: (2, "integer"), float: (3, "double"), str: (4, "string")}
        parameters = []
        for name, value in values.items():
            number, word = kinds[type(value)]
            parameters.append({"name": name, "value": {"type": number, f"{word}_value": value}})
        kind = "rcl_interfaces/srv/SetParameters"
        answer = self.peer.ask("/nnpp_edge/set_parameters", kind, {"parameters": parameters})
        return [each["reason"] for each in answer["results"] if not each["successful"]]

    def run(self, **values):
        """Have it run anew with these parameters, all others being the defaults."""
        if self.state == "active":
            self.change(4)
        if self.state == "inactive":
            self.change(2)
        assert self.set(**(DEFAULTS | values)) == []
        for heard in self.peer.heard.values():
            heard.clear()
        assert self.change(1) and self.change(3)

    def quiet(self):
        """Publish nothing more."""
        for name in ("odom", "map", "goal_pose"):
            self.peer.send("silence", name, "")

    def odom(self, x, y, yaw_deg=0.0):
        self.peer.send(
            "publish",
            "odom",
            "nav_msgs/msg/Odometry",
            qos="sensor",
            rate_hz=20.0,
            message={
                "header": {"frame_id": "map"},
                "child_frame_id": "base_link",
                "pose": {"pose": pose(x, y, yaw_deg)},
            },
        )

    def goal(self, x, y, yaw_deg=0.0, **more):
        message = {"header": {"frame_id": "map"}, "pose": pose(x, y, yaw_deg)}
        kind = "geometry_msgs/msg/PoseStamped"
        self.peer.send("publish", "goal_pose", kind, message=message, **more)

    def map(self, values, x=0.0, y=0.0):
        rows, cols = values.shape
        info = {"resolution": 0.25, "width": cols, "height": rows, "origin": pose(x, y)}
        message = {"header": {"frame_id": "map"}, "info": info, "data": values.ravel().tolist()}
        self.peer.send(
            "publish", "map", "nav_msgs/msg/OccupancyGrid", qos="latched", message=message
        )

    def path(self, holds=lambda poses: len(poses)):
        """The next path that is as wanted: (N, 3) x, y and yaw in degrees."""
        return poses_of(self.peer.wait("plan", lambda message: holds(poses_of(message))))

    def trouble(self, words):
        """Wait until the diagnostics say so."""

        def says(message):
            (status,) = message["status"]
            values = [pair["value"] for pair in status["values"]]
            return any(words in each for each in (status["message"], *values))

        return self.peer.wait("/diagnostics", says)

    def close(self):
        self.process.terminate()
        code = self.process.wait(10.0)
        self._thread.join(5.0)
        self.process.stderr.close()
        return code


def pose(x, y, yaw_deg=0.0):
    half = math.radians(yaw_deg) / 2.0
    return {
        "position": {"x": x, "y": y, "z": 0.0},
        "orientation": {"z": math.sin(half), "w": math.cos(half)},
    }


def poses_of(message):
    """(N, 3) x, y and yaw in degrees of a nav_msgs/Path."""
    found = []
    for stamped in message["poses"]:
        assert stamped["header"]["frame_id"] == message["header"]["frame_id"]
        at = stamped["pose"]["position"]
        turn = stamped["pose"]["orientation"]
        yaw = math.degrees(2.0 * math.atan2(turn["z"], turn["w"]))
        found.append((at["x"], at["y"], yaw))
    return np.array(found).reshape(-1, 3)


def turned(a, b):
    """Degrees between two headings."""
    return abs((a - b + 180.0) % 360.0 - 180.0)


@pytest.fixture(scope="module")
def peer(environment):
    with closing(Peer(environment)) as peer:
        yield peer


@pytest.fixture(scope="module")
def process(environment, peer):
    node = Node(environment, peer, "-p", "autostart_node:=false", "-p", "radius:=1.0")
    node.said("radius was set, and there is no such parameter")
    yield node
    assert node.close() == 0


@pytest.fixture
def node(process):
    """One node for all tests; each has it run anew."""
    yield process
    process.quiet()


def hall(rows=40, cols=60):
    """A room with a wall that leaves way along the upper side."""
    values = np.zeros((rows, cols), np.int8)
    values[: rows - 8, cols // 2] = 100
    return values


def test_from_a_latched_map_to_a_path_around_a_wall_and_whoever_joins_late_gets_it(node, peer):
    node.map(hall(), x=-5.0, y=2.0)
    node.run(radius_m=0.3)
    node.odom(-4.0, 4.0)
    node.goal(8.0, 4.0, 90.0)
    path = node.path()
    assert np.hypot(*(path[0, :2] - (-4.0, 4.0))) < 0.25
    assert np.hypot(*(path[-1, :2] - (8.0, 4.0))) < 0.25
    assert turned(path[-1, 2], 90.0) < 1.0  # the goal's own yaw
    beside = path[np.abs(path[:, 0] - 2.6) < 0.5]
    assert (beside[:, 1] > 10.0).all()  # by the way that the wall leaves
    steps = np.diff(path[:, :2], axis=0)
    yaws = np.degrees(np.arctan2(steps[:, 1], steps[:, 0]))
    assert turned(path[:-1, 2], yaws).max() < 0.1
    for topic, kind, qos in (
        ("/plan", "nav_msgs/msg/Path", "latched"),
        ("traversability", "nav_msgs/msg/OccupancyGrid", "latched"),
    ):
        peer.send("listen", topic, kind, qos=qos)
    assert set(peer.wait("plan_gears", lambda message: message["data"])["data"]) == {1}
    late = poses_of(peer.wait("/plan"))
    np.testing.assert_array_equal(late, path)
    seen = peer.wait("traversability")
    assert (np.reshape(seen["data"], (40, 60)) == 100)[:30, 30].all()


def test_an_elevation_map_is_sent_and_a_path_got_with_what_the_wheels_have(environment):
    """The example of docs/ros2.md, beside a node of its own."""
    apart = environment | {"ROS_DOMAIN_ID": str(1 + (os.getpid() + 50) % 100), "PYTHONPATH": ""}
    with closing(Node(apart, None, "-p", "map_size_m:=20.0", "-p", "resolution:=0.25")) as node:
        command = [sys.executable, ROOT / "deploy/ros2/send_elevations.py"]
        done = subprocess.run(command, env=apart, capture_output=True, text=True, timeout=60)
        node.said("grid_map_msgs is missing: install ros-DISTRO-grid-map-msgs, or send")
    path = np.array([line.split() for line in done.stdout.splitlines()], float)
    assert np.abs(path[[0, -1]] - [(-8.0, 0.0), (8.0, 0.0)]).max() < 0.26
    assert np.hypot(*path.T).min() > 1.5  # around the hill


def window(heights, x, y, side=0.25, **ring):
    """A grid_map_msgs/GridMap whose middle is there."""
    rows, cols = heights.shape
    place = {"resolution": side, "length_x": rows * side, "length_y": cols * side}
    message = grid_map(values=heights, **ring, **place, pose=pose(x, y))
    return message | {"header": {"frame_id": "map"}}


def test_a_window_that_moves_over_unknown_ground_is_taken_in_wherever_its_ring_begins(node, peer):
    node.run(map_size_m=30.0, resolution=0.25)
    node.odom(-10.0, 1.0)
    node.goal(10.0, 1.0)
    node.path(lambda poses: not len(poses))
    rng = np.random.default_rng(1)

    def send(message):
        peer.send("publish", "elevation_map", "grid_map_msgs/msg/GridMap", message=message)

    # a dam along y at x = 0, with a gap at y = -3; columns run against y in windows of 5 × 8 m
    for n, x in enumerate(np.arange(-12.5, 13.0, 2.5)):
        places = x + 2.5 - 0.25 * (0.5 + np.arange(20))
        across = 4.0 - 0.25 * (0.5 + np.arange(32))
        heights = np.zeros((20, 32))
        dam = (np.abs(places)[:, None] < 0.3) & ~(np.abs(across + 3.0)[None, :] < 0.6)
        heights[dam] = 3.0
        start = (int(rng.integers(20)), int(rng.integers(32)))
        send(window(heights, x, 0.0, start=start, row_by_row=bool(n % 2)))
        time.sleep(0.02)
    path = node.path()
    through = path[np.abs(path[:, 0]) < 0.3]
    assert len(through) and np.abs(through[:, 1] + 3.0).max() < 0.6
    # what has not been seen stays as it is: NaN tells nothing
    send(window(np.full((20, 32), math.nan), 0.0, 0.0))
    send(window(np.zeros((4, 4)), 0.0, 0.0, side=0.5))
    node.trouble("elevation_map: wanted cells of 0.25 m, got 0.5 m")
    assert len(node.path())
    send(window(np.full((20, 32), 3.0) * (np.arange(20) == 10)[:, None], 0.0, 0.0))
    node.path(lambda poses: not len(poses))  # the gap is shut


def test_a_life_of_two_rounds_through_all_states(node, peer):
    node.map(hall())
    for _ in range(2):
        node.run(radius_m=0.3)
        assert node.state == "active"
        node.odom(1.0, 1.0)
        node.goal(14.0, 1.0)
        assert len(node.path())
        assert node.set(rate_hz=0.0) == ["rate_hz: Expected float >= 0.001, got 0.0"]
        assert node.set(radius_m=-1.0)
        assert node.set(odom_timeout_s=2.0) == []
        assert node.change(4)  # deactivate: who follows the path stops
        node.path(lambda poses: not len(poses))
        assert node.state == "inactive"
        assert node.change(3)
        time.sleep(0.3)
        assert not any(map(len, map(poses_of, peer.heard["plan"])))  # the goal was forgotten
        node.goal(14.0, 1.0)
        assert len(node.path())
        assert node.change(4) and node.change(2)
        assert node.state == "unconfigured"
    assert node.set(vehicle="no-such.toml") == []
    assert not node.change(1)
    node.said("cannot be configured: wanted a vehicle's file or the name of a shipped one")
    assert node.state == "unconfigured"


def test_a_service_and_actions_plan_as_nav2_asks(node, peer):
    node.map(hall())
    node.run(radius_m=0.3)
    node.odom(1.0, 1.0)

    def stamped(x, y, yaw_deg=0.0, frame="map"):
        return {"header": {"frame_id": frame}, "pose": pose(x, y, yaw_deg)}

    ends = {"start": stamped(14.0, 1.0), "goal": stamped(1.0, 2.0, 180.0)}
    plan = poses_of(peer.ask("get_plan", "nav_msgs/srv/GetPlan", ends)["plan"])
    assert np.hypot(*(plan[0, :2] - (14.0, 1.0))) < 0.25 and plan[:, 1].max() > 7.5
    assert turned(plan[-1, 2], 180.0) < 1.0
    blocked = {"goal": stamped(7.6, 1.0)}  # from where the robot is
    for tolerance_m, ends_m in ((0.0, None), (0.2, None), (0.6, (0.2, 0.6))):
        asked = blocked | {"tolerance": tolerance_m}
        plan = poses_of(peer.ask("get_plan", "nav_msgs/srv/GetPlan", asked)["plan"])
        assert bool(len(plan)) == bool(ends_m)
        if ends_m:  # beside the wall, as near to the goal as the disc can be
            assert np.hypot(*(plan[0, :2] - (1.0, 1.0))) < 0.25
            assert ends_m[0] < np.hypot(*(plan[-1, :2] - (7.6, 1.0))) < ends_m[1]

    kind = "nav2_msgs/action/ComputePathToPose"

    def act(name="compute_path_to_pose", kind=kind, **message):
        return peer.ask(name, kind, message, op="act")

    result = act(goal=stamped(14.0, 1.0, 90.0))
    assert result["error_code"] == 0 and result["planning_time"]["sec"] < 5
    path = poses_of(result["path"])
    assert turned(path[-1, 2], 90.0) < 1.0
    np.testing.assert_array_equal(node.path(), path)  # the loop goes there from now on
    for code, message in (
        (201, {"goal": stamped(14.0, 1.0), "planner_id": "Smac"}),
        (202, {"goal": stamped(14.0, 1.0, frame="odom")}),
        (203, {"goal": stamped(14.0, 1.0), "use_start": True, "start": stamped(-9.0, 1.0)}),
        (204, {"goal": stamped(90.0, 1.0)}),
        (205, {"goal": stamped(14.0, 1.0), "use_start": True, "start": stamped(7.6, 1.0)}),
        (206, {"goal": stamped(7.6, 1.0)}),
    ):
        result = act(**message)
        assert (result["error_code"], result["path"]["poses"]) == (code, []), message
        assert result["error_msg"]
    shut = hall()
    shut[:, 30] = 100
    node.map(shut)
    wait_until(lambda: act(goal=stamped(14.0, 1.0))["error_code"] == 208)
    node.map(hall())

    through = "nav2_msgs/action/ComputePathThroughPoses"
    goals = {"goals": [stamped(3.0, 8.0), stamped(14.0, 1.0)]}
    result = act("compute_path_through_poses", through, goals=goals)
    path = poses_of(result["path"])
    assert result["error_code"] == 0
    assert np.hypot(*(path[:, :2] - (3.0, 8.0)).T).min() < 0.25
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    assert steps.min() > 0.2 and steps.max() < 0.4  # no pose twice where legs join
    assert act("compute_path_through_poses", through)["error_code"] == 309


@pytest.fixture
def session():
    """One of a map of 4 × 4 cells of 0.25 m, whose loop does not run, of a node that is none."""
    node = MagicMock(settings=OnboardLoop())
    node.listener = MagicMock(robot=None, goal=None, refused="")
    node.listener.overdue.return_value = ""
    navigator = Navigator(Ground(np.ones((4, 4), np.float32)), "astar")
    return Session(node, navigator, MapFrame(0.25)), node


def test_a_counter_that_has_grown_is_a_warning_and_the_first_counters_are_none(session):
    session, node = session

    def told(late):
        counters = Counters(ticks=17, overruns=late)
        session.publish(StatusMessage(17, Status.OK, "OK by standing", counters))
        return [call.args[0] for call in node.outlet.diagnose.call_args_list]

    assert [told(late)[-1] for late in (0, 0, 1, 1)] == ["OK", "OK", "WARN", "OK"]
    session.hush()  # a tick that goes on then is not heard of
    assert len(told(2)) == 4


def test_the_newest_pose_is_read_between_patches_and_none_while_one_is_too_old(session):
    session, node = session
    for _ in range(3):
        session.put(MapPatch(0, 0, cost=np.ones((1, 1))))
    inputs = session.poll()
    found = [type(next(inputs))]
    node.listener.robot = PoseInFrame(0.5, 0.25, 0.0)
    found += [type(next(inputs)), type(next(inputs))]
    node.listener.robot = PoseInFrame(0.5, 0.5, 0.0)
    node.listener.overdue.return_value = "the newest map is 3 s old"
    assert [*found, *map(type, inputs)] == [MapPatch, Pose, MapPatch, MapPatch]
    for why, kinds in (("", [Pose]), ("the newest map is 3 s old", []), ("", [Pose])):
        node.listener.overdue.return_value = why
        assert [*map(type, session.poll())] == kinds


@pytest.mark.parametrize("words", [["foo"], ["-p", "rate_hz=10"], ["--params-file", "none.yaml"]])
def test_arguments_that_ros_does_not_take_are_told_in_a_line(words):
    command = [sys.executable, "-m", "nnpp_edge.cli.main", "ros", "--ros-args", *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: ROS takes no such arguments: ")
    assert "Traceback" not in done.stderr


@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # of rclpy's import
def test_a_planner_for_a_plan_that_is_asked_for_is_not_made_in_the_loops_thread(monkeypatch):
    threads = []
    made = DynamicPlanner.__setstate__

    def noted(self, state):
        threads.append(threading.current_thread())
        made(self, state)

    monkeypatch.setattr(DynamicPlanner, "__setstate__", noted)
    cost = np.full((40, 60), 0.1, np.float32)
    navigator = Navigator(Ground(cost), "astar")
    node = MagicMock()
    node.own.global_frame = "map"
    node.outlet.now_ns = 0
    node.listener.robot = PoseInFrame(1.0, 1.0, 0.0)
    session = MagicMock(navigator=navigator, frame=MapFrame(0.25, frame_id="map"))
    questions = Questions(node)
    node.frames.place.return_value = PoseInFrame(14.0, 1.0, 0.0)
    answer = node.create_service.call_args.args[2]
    asked = answer(GetPlan.Request(), GetPlan.Response())
    with pytest.raises(StopIteration) as answered:
        while True:
            asked.send(None)  # as the executor does
            questions.after_tick(session)  # as the loop does
            time.sleep(0.001)
    questions.close()
    assert answered.value.value.plan.poses
    assert len(threads) == 1 and threading.current_thread() not in threads
