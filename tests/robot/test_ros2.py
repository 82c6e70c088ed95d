"""The node against ROS 2 itself: `nnpp-edge ros` in one process, plain rclpy in this one.

They meet on the loopback interface, in a domain of their own. Nav2's messages, which are on no
wheel, are built by `ros2_types`.
"""

import os
import subprocess
import sys
import threading
import time
from contextlib import closing
from importlib import import_module
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

pytest.importorskip("rclpy")

from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Goals, OccupancyGrid
from nav_msgs.msg import Path as PathOfPoses
from nav_msgs.srv import GetPlan
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Int8MultiArray

from nnpp_edge.robot.ros2 import questions as of_questions
from nnpp_edge.robot.ros2.frames import PoseInFrame
from nnpp_edge.robot.ros2.session import Session
from nnpp_edge.ros.maps import MapFrame
from nnpp_edge.runtime import Counters, DynamicPlanner, Ground, Navigator
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.messages import MapPatch, Pose, StatusMessage
from nnpp_edge.runtime.loop.settings import OnboardLoop
from tests.robot.ros2_cases import LATCHED, Peer, grid, odometry, posed, stamped
from tests.robot.ros2_types import built

pytestmark = pytest.mark.filterwarnings(
    "ignore:module 'sre_:DeprecationWarning"
)  # of rclpy's import
ROOT = Path(__file__).parents[2]
DOMAIN = 1 + os.getpid() % 100
PARAMETERS = {"radius_m": 0.3, "odom_timeout_s": 1.0, "vehicle": ""}
CONFIGURE, CLEAN_UP, ACTIVATE, DEACTIVATE = range(1, 5)


class Node:
    """The node's process, and the peer through which it is spoken to."""

    def __init__(self, peer, *arguments, **environment):
        self.peer = peer
        self.process = subprocess.Popen(
            [sys.executable, "-m", "nnpp_edge.cli.main", "ros", "--ros-args", *arguments],
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | environment,
            cwd=ROOT,
        )
        self.lines = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        self.lines += self.process.stderr  # as they come

    def said(self, words):
        self.peer.until(lambda: any(words in line for line in list(self.lines)))

    @property
    def state(self):
        answer = self.peer.ask("/nnpp_edge/get_state", GetState, GetState.Request())
        return answer.current_state.label

    def change(self, transition):
        """Whether the transition succeeded."""
        request = ChangeState.Request()
        request.transition.id = transition
        return self.peer.ask("/nnpp_edge/change_state", ChangeState, request).success

    def set(self, **values):
        """Set parameters; why one was refused, or nothing."""
        named = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParameters.Request(parameters=named)
        answer = self.peer.ask("/nnpp_edge/set_parameters", SetParameters, request)
        return [each.reason for each in answer.results if not each.successful]

    def run(self):
        """Have it run anew, with `PARAMETERS`."""
        if self.state == "active":
            self.change(DEACTIVATE)
        if self.state == "inactive":
            self.change(CLEAN_UP)
        assert self.set(**PARAMETERS) == []
        for heard in self.peer.heard.values():
            heard.clear()
        assert self.change(CONFIGURE) and self.change(ACTIVATE)

    def odom(self, x, y):
        self.peer.publish("odom", odometry(posed(x, y)), qos_profile_sensor_data, rate_hz=20.0)

    def goal(self, *place):
        self.peer.publish("goal_pose", stamped(*place))

    def map(self, values, **place):
        self.peer.publish("map", grid(*values.shape, values, **place), LATCHED)

    def path(self, holds=len):
        """The next path that is as wanted: (N, 3) x, y and yaw in degrees."""
        return poses_of(self.peer.wait("plan", lambda message: holds(poses_of(message))))

    def close(self):
        self.process.terminate()
        code = self.process.wait(10.0)
        self._thread.join(5.0)
        self.process.stderr.close()
        return code


def stopped(poses):
    return not len(poses)


def poses_of(message):
    """(N, 3) x, y and yaw in degrees of a nav_msgs/Path."""
    found = []
    for each in message.poses:
        assert each.header.frame_id == message.header.frame_id
        at = each.pose.position
        turn = each.pose.orientation
        found.append((at.x, at.y, 2.0 * np.degrees(np.arctan2(turn.z, turn.w))))
    return np.array(found).reshape(-1, 3)


def turned(a, b):
    """Degrees between two headings."""
    return abs((a - b + 180.0) % 360.0 - 180.0)


def apart(pose, place):
    """Metres between the place of a pose and another."""
    return np.hypot(*(pose[:2] - place))


@pytest.fixture(scope="module")
def peer():
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patched.setenv("ROS_DOMAIN_ID", str(DOMAIN))
        patched.setenv("PYTHONPATH", str(built()))
        with closing(Peer(DOMAIN)) as peer:
            peer.listen("plan", PathOfPoses, LATCHED)
            peer.listen("plan_gears", Int8MultiArray, LATCHED)
            yield peer


@pytest.fixture(scope="module")
def process(peer):
    node = Node(peer, "-p", "autostart_node:=false", "-p", "radius:=1.0")
    node.said("radius was set, and there is no such parameter")
    yield node
    assert node.close() == 0


@pytest.fixture
def node(process, peer):
    """One node for all tests; each has it run anew."""
    yield process
    peer.silence()


def hall(rows=40, cols=60):
    """A room with a wall that leaves way along the upper side."""
    values = np.zeros((rows, cols), np.int8)
    values[: rows - 8, cols // 2] = 100
    return values


def test_from_a_latched_map_to_a_path_around_a_wall_and_whoever_joins_late_gets_it(node, peer):
    node.map(hall(), x=-5.0, y=2.0)
    node.run()
    node.odom(-4.0, 4.0)
    node.goal(8.0, 4.0, 90.0)
    path = node.path()
    assert apart(path[0], (-4.0, 4.0)) < 0.25 and apart(path[-1], (8.0, 4.0)) < 0.25
    assert turned(path[-1, 2], 90.0) < 1.0  # the goal's own yaw
    beside = path[np.abs(path[:, 0] - 2.6) < 0.5]
    assert (beside[:, 1] > 10.0).all()  # by the way that the wall leaves
    steps = np.diff(path[:, :2], axis=0)
    yaws = np.degrees(np.arctan2(steps[:, 1], steps[:, 0]))
    assert turned(path[:-1, 2], yaws).max() < 0.1
    peer.listen("/plan", PathOfPoses, LATCHED)
    peer.listen("traversability", OccupancyGrid, LATCHED)
    assert set(peer.wait("plan_gears", lambda message: message.data).data) == {1}
    np.testing.assert_array_equal(poses_of(peer.wait("/plan")), path)
    seen = peer.wait("traversability")
    assert (np.reshape(seen.data, (40, 60)) == 100)[:30, 30].all()


def test_an_elevation_map_is_sent_and_a_path_got_with_what_the_wheels_have(peer):
    """The example of docs/ros2.md, beside a node of its own."""
    alone = {"ROS_DOMAIN_ID": str(DOMAIN + 100), "PYTHONPATH": ""}
    words = ("-p", "map_size_m:=20.0", "-p", "resolution:=0.25")
    with closing(Node(peer, *words, **alone)) as node:
        command = [sys.executable, ROOT / "deploy/ros2/send_elevations.py"]
        environment = os.environ | alone
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
        node.said("grid_map_msgs is missing: install ros-DISTRO-grid-map-msgs, or send")
    path = np.array([line.split() for line in done.stdout.splitlines()], float)
    assert np.abs(path[[0, -1]] - [(-8.0, 0.0), (8.0, 0.0)]).max() < 0.26
    assert np.hypot(*path.T).min() > 1.5  # around the hill


def test_a_life_of_two_rounds_through_all_states(node, peer):
    node.map(hall())
    for _ in range(2):
        node.run()
        assert node.state == "active"
        node.odom(1.0, 1.0)
        node.goal(14.0, 1.0)
        assert len(node.path())
        assert node.set(rate_hz=0.0) == ["rate_hz: Expected float >= 0.001, got 0.0"]
        assert node.set(radius_m=-1.0)
        assert node.set(odom_timeout_s=2.0) == []
        assert node.change(DEACTIVATE)  # who follows the path stops
        node.path(stopped)
        assert node.state == "inactive"
        assert node.change(ACTIVATE)
        peer.pause(0.3)
        assert not any(map(len, map(poses_of, peer.heard["plan"])))  # the goal was forgotten
        node.goal(14.0, 1.0)
        assert len(node.path())
        assert node.change(DEACTIVATE) and node.change(CLEAN_UP)
        assert node.state == "unconfigured"
    assert node.set(vehicle="no-such.toml") == []
    assert not node.change(CONFIGURE)
    node.said("cannot be configured: wanted a vehicle's file or the name of a shipped one")
    assert node.state == "unconfigured"


def test_a_service_plans_from_any_place(node, peer):
    node.map(hall())
    node.run()
    node.odom(1.0, 1.0)

    def asked(**request):
        return poses_of(peer.ask("get_plan", GetPlan, GetPlan.Request(**request)).plan)

    plan = asked(start=stamped(14.0, 1.0), goal=stamped(1.0, 2.0, 180.0))
    assert apart(plan[0], (14.0, 1.0)) < 0.25 and plan[:, 1].max() > 7.5
    assert turned(plan[-1, 2], 180.0) < 1.0
    blocked = stamped(7.6, 1.0)
    assert [len(asked(goal=blocked, tolerance=most)) for most in (0.0, 0.2)] == [0, 0]
    plan = asked(goal=blocked, tolerance=0.6)  # from where the robot is
    assert apart(plan[0], (1.0, 1.0)) < 0.25
    assert 0.2 < apart(plan[-1], (7.6, 1.0)) < 0.6  # as near to the goal as the disc can be


def test_actions_plan_as_nav2_asks(node, peer):
    node.map(hall())
    node.run()
    node.odom(1.0, 1.0)
    actions = import_module("nav2_msgs.action")

    def to_pose(*goal, **more):
        kind = actions.ComputePathToPose
        return peer.act("compute_path_to_pose", kind, kind.Goal(goal=stamped(*goal), **more))

    def through(*goals):
        kind = actions.ComputePathThroughPoses
        return peer.act("compute_path_through_poses", kind, kind.Goal(goals=Goals(goals=goals)))

    result = to_pose(14.0, 1.0, 90.0)
    assert result.error_code == 0 and result.planning_time.sec < 5
    path = poses_of(result.path)
    assert turned(path[-1, 2], 90.0) < 1.0
    np.testing.assert_array_equal(node.path(), path)  # the loop goes there from now on
    for code, goal, more in (
        (201, (14.0, 1.0), {"planner_id": "Smac"}),
        (202, (14.0, 1.0, 0.0, "odom"), {}),
        (203, (14.0, 1.0), {"use_start": True, "start": stamped(-9.0, 1.0)}),
        (204, (90.0, 1.0), {}),
        (205, (14.0, 1.0), {"use_start": True, "start": stamped(7.6, 1.0)}),
        (206, (7.6, 1.0), {}),
    ):
        result = to_pose(*goal, **more)
        assert (result.error_code, result.path.poses) == (code, []), goal
        assert result.error_msg
    shut = hall()
    shut[:, 30] = 100
    node.map(shut)
    peer.until(lambda: to_pose(14.0, 1.0).error_code == 208)
    node.map(hall())
    peer.until(lambda: to_pose(14.0, 1.0).error_code == 0)

    result = through(stamped(3.0, 8.0), stamped(14.0, 1.0))
    path = poses_of(result.path)
    assert result.error_code == 0
    assert min(apart(pose, (3.0, 8.0)) for pose in path) < 0.25
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    assert steps.min() > 0.2 and steps.max() < 0.4  # no pose twice where legs join
    assert through().error_code == 309


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


def test_the_newest_pose_is_read_between_patches(session):
    session, node = session
    for _ in range(3):
        session.put(MapPatch(0, 0, cost=np.ones((1, 1))))
    inputs = session.poll()
    found = [type(next(inputs))]
    for y in (0.25, 0.5):
        node.listener.robot = PoseInFrame(0.5, y, 0.0)
        found += [type(next(inputs)), type(next(inputs))]
    assert [*found, *map(type, inputs)] == [MapPatch, Pose, MapPatch, Pose, MapPatch]


@pytest.mark.parametrize("words", [["foo"], ["-p", "rate_hz=10"], ["--params-file", "none.yaml"]])
def test_arguments_that_ros_does_not_take_are_told_in_a_line(words):
    command = [sys.executable, "-m", "nnpp_edge.cli.main", "ros", "--ros-args", *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: ROS takes no such arguments: ")
    assert "Traceback" not in done.stderr


def test_a_planner_for_a_plan_that_is_asked_for_is_not_made_in_the_loops_thread(monkeypatch):
    threads = []
    made = DynamicPlanner.__setstate__

    def noted(self, state):
        threads.append(threading.current_thread())
        made(self, state)

    monkeypatch.setattr(DynamicPlanner, "__setstate__", noted)
    monkeypatch.setattr(of_questions, "message_type", lambda *_: None)  # no actions
    cost = np.full((40, 60), 0.1, np.float32)
    navigator = Navigator(Ground(cost), "astar")
    node = MagicMock()
    node.own.global_frame = "map"
    node.outlet.now_ns = 0
    node.listener.robot = PoseInFrame(1.0, 1.0, 0.0)
    session = MagicMock(navigator=navigator, frame=MapFrame(0.25, frame_id="map"))
    questions = of_questions.Questions(node)
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
