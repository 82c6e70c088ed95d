"""The node by the callbacks of its subscriptions, in this process: whatever a message holds, the loop
goes on, or an empty path is out and a diagnostic says why.
"""

import math
import threading
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

import rclpy
from nav_msgs.msg import Path
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from nnpp_edge.robot.ros2 import node as nodes
from nnpp_edge.robot.ros2 import session as sessions
from nnpp_edge.robot.ros2.inputs import TOPICS
from nnpp_edge.robot.ros2.node import PlannerNode
from nnpp_edge.runtime import Loop
from nnpp_edge.runtime.loop import settings
from tests.robot.conftest import wait_until
from tests.robot.ros2_cases import grid, odometry, posed, stamped
from tests.robot.test_ros_maps import as_objects
from tests.robot.test_ros_maps import message as grid_map

pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # of rosidl's


class Alone:
    """A node that hears and tells this process alone: `hear` has the callbacks of its subscriptions,
    `sent` what its publishers were given.
    """

    def __init__(self, monkeypatch):
        self.hear = {}
        self.sent = {}

        def publisher(node, kind, topic, qos):
            publish = self.sent.setdefault(topic, []).append
            return SimpleNamespace(publish=publish, get_subscription_count=lambda: 1)

        def subscription(node, kind, topic, hear, qos):
            self.hear[topic] = hear

        for name, replaced in (
            ("create_lifecycle_publisher", publisher),
            ("create_subscription", subscription),
            ("destroy_lifecycle_publisher", lambda node, made: None),
            ("destroy_subscription", lambda node, made: None),
        ):
            monkeypatch.setattr(PlannerNode, name, replaced)
        self.node = PlannerNode()

    def begin(self, **values):
        """Run with these parameters, and whatever the age of a pose."""
        self.set(**{"odom_timeout_s": 0.0} | values)
        return self.node.trigger_configure().name, self.node.trigger_activate().name

    def set(self, **values):
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        self.node.set_parameters(parameters)

    def begin_to_drive(self, message):
        self.begin()
        self.hear["map"](message)
        self.drive()

    def drive(self):
        """Stand at one end of a room, and be sent to the other."""
        self.stand()
        self.hear["goal_pose"](stamped(14.0, 1.0))

    def stand(self, pose=None):
        self.hear["odom"](odometry(pose or posed(1.0, 1.0)))

    def path(self, holds=len):
        """The next path that is as wanted: (x, y) of its poses."""
        self.sent["plan"].clear()
        return self.newest(holds)

    def newest(self, holds=len):
        """Wait until the newest path is as wanted."""
        found = [()]

        def came():
            sent = self.sent["plan"][-1:]
            for content in sent:
                poses = deserialize_message(content, Path).poses
                found[0] = [(each.pose.position.x, each.pose.position.y) for each in poses]
            return sent and holds(found[0])

        wait_until(came)
        return found[0]

    def told(self, words=""):
        """The newest diagnostics, once they say so."""

        def said():
            (status,) = self.sent["/diagnostics"][-1].status
            return "\n".join((status.message, *(pair.value for pair in status.values)))

        wait_until(lambda: self.sent["/diagnostics"] and words in said())
        return said()


def stopped(places):
    return not places


@pytest.fixture
def alone(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    monkeypatch.setattr(sessions, "Loop", partial(Loop, status_every_s=0.05))
    rclpy.init()
    alone = Alone(monkeypatch)
    yield alone
    alone.node.trigger_shutdown()
    alone.node.destroy_node()
    rclpy.shutdown()


BAD = (
    ("map", grid(resolution=math.nan), "resolution must be metres above 0, got nan"),
    ("map", grid(20, 30, resolution=1e-9), "wanted cells of at least 0.003 m for a vehicle of 0.6"),
    ("map", grid(width=2**32 - 1), "wanted 40 × 4294967295 whole numbers as data"),
    ("map", grid(frame_id="odom"), "wanted a map in the"),
    ("elevation_points", PointCloud2(), "wanted map_size_m or map_file for elevations"),
    ("goal_pose", stamped(1.0, 1.0, frame_id="base_link"), "wanted a goal in the frame 'map', got"),
    ("goal_pose", stamped(1.0, 1.0, w=0.0), "wanted a goal with a unit"),
    ("pose", stamped(1.0, 1.0, frame_id="odom"), "wanted a pose in the frame 'map', got one in"),
    ("odom", odometry(posed(1.0, 1.0), child_frame_id="camera"), "wanted the robot's frame"),
)


def test_what_is_refused_leaves_the_loop_as_it_was(alone):
    alone.begin(radius_m=0.3)
    alone.hear["map"](grid())
    alone.drive()
    before = alone.path()
    for topic, message, words in BAD:
        for _ in range(2):  # sent again it is no other
            alone.hear[topic](message)
            alone.told(f"{topic}: {words}")
            assert alone.path() == before
        alone.hear["map"](grid())
    wait_until(lambda: "map: " not in alone.told())  # once another is taken
    alone.hear["map"](grid(80, 100, x=-1.0, y=-1.0))  # the robot and its goal stay there
    assert alone.path() == before


def test_what_cannot_be_gone_to_stops_who_follows_and_is_told(alone):
    message = grid()
    message.data[20 * 60 + 30] = 100
    alone.begin_to_drive(message)
    for x, y, words in (
        (400.0, 1.0, "GOAL_OUTSIDE_MAP: the map has (40, 60) cells"),
        (7.6, 5.1, "GOAL_BLOCKED: the goal is impassable"),
    ):
        assert alone.path()
        alone.hear["goal_pose"](stamped(x, y))
        assert alone.newest(stopped) == []
        alone.told(words)
        alone.drive()


def test_a_part_of_a_map_lies_on_the_newest_that_was_taken_and_unknown_cells_are_shut(
    alone, monkeypatch
):
    monkeypatch.setitem(TOPICS, "map_updates", "nav_msgs.msg:Path")  # of no wheel, any type will do
    alone.begin(radius_m=0.3)
    alone.hear["map"](grid(60, 80, x=-2.0, y=-2.0))
    alone.drive()
    assert alone.path()
    alone.hear["map"](grid(resolution=1e-9))
    wall = np.full(60, 100)
    wall[40:45] = 0
    alone.hear["map_updates"](
        SimpleNamespace(header=Header(frame_id="map"), x=30, y=0, width=1, height=60, data=wall)
    )
    places = np.array(alone.newest(lambda places: np.ptp(places, axis=0)[1] > 1.0))
    gap = np.abs(places - (5.625, 8.625))
    assert gap[gap[:, 0] < 0.2, 1].max() < 0.4
    message = grid(60, 80, x=-2.0, y=-2.0)
    for row in range(60):
        message.data[80 * row + 30] = -1
    alone.hear["map"](message)
    alone.newest(stopped)


def test_windows_of_heights_are_taken_in_and_what_is_not_seen_stays(alone, monkeypatch):
    monkeypatch.setitem(
        TOPICS, "elevation_map", "nav_msgs.msg:Path"
    )  # of no wheel, any type will do
    alone.begin(map_size_m=30.0, resolution=0.25)

    def send(heights, x=0.0, side=0.25):
        """Around (x, 0); rows run against x, columns against y."""
        rows, cols = heights.shape
        lengths = {"length_x": side * rows, "length_y": side * cols}
        place = {"resolution": side, "pose": posed(x, 0.0)}
        window = as_objects(grid_map(values=heights, **lengths, **place))
        window.header.frame_id = "map"
        alone.hear["elevation_map"](window)

    heights = np.zeros((120, 120), np.float32)
    heights[30:32] = 3.0  # a dam along y at x = 7.25, with a gap at y = -3
    heights[30:32, 69:75] = 0.0
    send(heights[:60], 7.5)
    send(heights[60:], -7.5)
    alone.drive()

    def by_the_gap(places):
        through = [y for x, y in places if abs(x - 7.25) < 0.3]
        return through and np.abs(np.add(through, 3.0)).max() < 0.9

    alone.newest(by_the_gap)
    send(np.full((60, 60), np.nan, np.float32))
    send(np.zeros((4, 4), np.float32), side=0.5)
    alone.told("elevation_map: wanted cells of 0.25 m, got 0.5 m")
    assert by_the_gap(alone.path())
    send(np.full((4, 120), 3.0, np.float32), 7.25)  # the gap is shut
    alone.newest(stopped)


class Boom(Exception):
    """Anything that nobody has thought of."""


def raising(*_, **__):
    raise Boom("no more\nmemory")


@pytest.mark.parametrize(
    ("module", "name"),
    [(nodes, "ground_of"), (settings, "Navigator"), (nodes, "Session"), (sessions, "Loop")],
)
def test_whatever_fails_on_the_way_to_a_new_map_the_loop_before_goes_on(
    alone, monkeypatch, module, name
):
    alone.begin_to_drive(grid())
    before = alone.path()
    other = grid(x=-0.5, y=-0.5)
    with monkeypatch.context() as patched:
        patched.setattr(module, name, raising)
        alone.hear["map"](other)
        alone.told("map: Boom: no more memory")
        assert alone.path() == before
    alone.hear["map"](other)
    assert alone.path() == before
    assert alone.node.session.frame.x == -0.5


def test_without_a_loop_an_empty_path_is_out_at_once_and_a_diagnostic_says_why(alone, monkeypatch):
    assert alone.begin() == ("SUCCESS", "SUCCESS")
    alone.told("waiting for a map")
    assert alone.newest(stopped) == []
    alone.hear["map"](grid(resolution=0.0))
    alone.told("waiting for a map; map: resolution must be")
    alone.hear["map"](grid())
    alone.drive()
    assert alone.newest()
    for other, owner, name, words in (
        (grid(80, 100), threading.Thread, "start", "map: Boom: no more memory"),
        (grid(90, 100), Loop, "run", "the loop has ended: Boom: no more memory"),
    ):
        with monkeypatch.context() as patched:
            patched.setattr(owner, name, raising)
            alone.hear["map"](other)
            alone.told(words)
        assert alone.newest(stopped) == []
        alone.hear["map"](other)
        assert alone.newest()


BAD_POSES = (
    (posed(1.0, 1.0, w=0.0), "wanted a pose with a unit quaternion"),
    (posed(1.0, 1.0, w=math.nan), "wanted a pose with a unit quaternion"),
    (posed(math.inf, 1.0), "wanted a pose at finite metres"),
)


def test_a_pose_that_is_refused_makes_the_one_before_no_younger(alone):
    alone.begin_to_drive(grid())
    assert alone.path()
    alone.set(odom_timeout_s=0.2)
    for pose, words in BAD_POSES:
        alone.stand(pose)
        alone.told(f"odom: {words}")

    def too_old(places):
        alone.stand(BAD_POSES[0][0])
        return not places

    alone.newest(too_old)
    alone.told("NO_POSE: the newest pose is ")
    alone.set(odom_timeout_s=0.0)
    alone.stand(posed(1e300, 1.0))
    alone.told("START_OUTSIDE_MAP: the map has (40, 60) cells")
    alone.stand()
    assert alone.newest()


def test_a_map_that_is_too_old_stops_who_follows_though_poses_come(alone):
    alone.begin_to_drive(grid())
    assert alone.path()
    alone.set(map_timeout_s=0.3)

    def stopped_though_it_stands(places):
        alone.stand()
        return not places

    for _ in range(20):
        alone.path(stopped_though_it_stands)
    alone.told("NO_POSE: the newest map is ")

    def sent_again(places):
        alone.hear["map"](grid())
        return places

    assert alone.newest(sent_again)
