"""Poses in other frames, against a stand-in of tf2: no wheel has it. `Buffer` has the methods and
errors that tf2_ros documents, `do_transform_pose` is that of tf2_geometry_msgs by matrices.
"""

import math
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import Pose, Quaternion, TransformStamped, Vector3

from nnpp_edge.robot.ros2.frames import Frames
from nnpp_edge.robot.ros2.parameters import Own
from nnpp_edge.runtime.loop.messages import InvalidMessageError


class TransformException(Exception):
    """Of tf2, that all of its errors derive from."""


class LookupException(TransformException):
    """A frame is not known."""


class ConnectivityException(TransformException):
    """Two frames are in no common tree."""


class Buffer:
    """Transforms from child to parent frames, all static."""

    def __init__(self, cache_time=None, node=None):
        self._parents = {}

    def set_transform_static(self, transform, authority):
        self._parents[transform.child_frame_id] = transform

    def lookup_transform(self, target_frame, source_frame, time, timeout=None):
        if time.nanoseconds:
            raise LookupException("wanted the newest")
        known = {*self._parents, *(each.header.frame_id for each in self._parents.values())}
        for frame, argument in ((target_frame, "target_frame"), (source_frame, "source_frame")):
            if frame not in known:
                raise LookupException(
                    f'"{frame}" passed to lookupTransform argument {argument} does not exist. '
                )
        to_root = {}
        for frame in (target_frame, source_frame):
            whole = np.eye(4)
            at = frame
            while at in self._parents:
                whole = matrix(self._parents[at].transform) @ whole
                at = self._parents[at].header.frame_id
            to_root[frame] = (at, whole)
        if to_root[target_frame][0] != to_root[source_frame][0]:
            raise ConnectivityException(
                f"Could not find a connection between '{target_frame}' and '{source_frame}' "
                "because they are not part of the same tree.Tf has two or more unconnected trees."
            )
        whole = np.linalg.inv(to_root[target_frame][1]) @ to_root[source_frame][1]
        found = TransformStamped(child_frame_id=source_frame)
        found.header.frame_id = target_frame
        found.transform.rotation = quaternion(whole)
        x, y, z = whole[:3, 3].tolist()
        found.transform.translation = Vector3(x=x, y=y, z=z)
        return found


def matrix(transform):
    """4 × 4, of a Transform."""
    turn = transform.rotation
    w = turn.w
    v = np.array((turn.x, turn.y, turn.z))
    cross = np.array(((0.0, -v[2], v[1]), (v[2], 0.0, -v[0]), (-v[1], v[0], 0.0)))
    found = np.eye(4)
    found[:3, :3] += 2.0 * (w * cross + cross @ cross)
    move = transform.translation
    found[:3, 3] = move.x, move.y, move.z
    return found


def quaternion(whole):
    """Of a turn by less than 180°."""
    w = 0.5 * math.sqrt(1.0 + np.trace(whole[:3, :3]))
    x, y, z = (whole[(2, 0, 1), (1, 2, 0)] - whole[(1, 2, 0), (2, 0, 1)]) / (4.0 * w)
    return Quaternion(x=x, y=y, z=z, w=w)


def do_transform_pose(pose, transform):
    own = SimpleNamespace(rotation=pose.orientation, translation=pose.position)
    whole = matrix(transform.transform) @ matrix(own)
    found = Pose(orientation=quaternion(whole))
    found.position.x, found.position.y, found.position.z = whole[:3, 3].tolist()
    return found


def posed(x, y, yaw_deg):
    half = math.radians(yaw_deg) / 2.0
    found = Pose(orientation=Quaternion(z=math.sin(half), w=math.cos(half)))
    found.position.x, found.position.y = x, y
    return found


@pytest.fixture
def frames(monkeypatch):
    """A node's frames: camera on base_link on odom on map, and one that hangs on nothing."""
    tf2_ros = ModuleType("tf2_ros")
    tf2_ros.Buffer = Buffer
    tf2_ros.TransformListener = lambda buffer, node: (buffer, node)
    geometry = ModuleType("tf2_geometry_msgs")
    geometry.do_transform_pose = do_transform_pose
    monkeypatch.setitem(sys.modules, "tf2_ros", tf2_ros)
    monkeypatch.setitem(sys.modules, "tf2_geometry_msgs", geometry)
    made = Frames(SimpleNamespace(own=Own()))
    for parent, child, pose in (
        ("map", "odom", posed(10.0, 5.0, 90.0)),
        ("odom", "base_link", posed(2.0, 1.0, 45.0)),
        ("world", "beacon", posed(0.0, 0.0, 0.0)),
    ):
        transform = TransformStamped(child_frame_id=child)
        transform.header.frame_id = parent
        transform.transform.rotation = pose.orientation
        at = pose.position
        transform.transform.translation = Vector3(x=at.x, y=at.y, z=at.z)
        made._buffer.set_transform_static(transform, "test")
    return made


@pytest.mark.parametrize(
    ("frame", "pose", "wanted"),
    [
        ("map", (1.0, 2.0, 30.0), (1.0, 2.0, 30.0)),
        ("odom", (3.0, 0.0, -45.0), (10.0, 8.0, 45.0)),
        ("odom", (0.0, 4.0, 60.0), (6.0, 5.0, 150.0)),
        ("base_link", (0.0, 0.0, 0.0), (9.0, 7.0, 135.0)),
        ("base_link", (math.sqrt(2.0), 0.0, -90.0), (8.0, 8.0, 45.0)),
    ],
)
def test_a_pose_in_another_frame_is_taken_to_the_global_one_by_tf2(frames, frame, pose, wanted):
    place = frames.place(posed(*pose), frame, "a goal")
    assert (place.x, place.y) == pytest.approx(wanted[:2])
    assert math.degrees(place.yaw_rad) == pytest.approx(wanted[2])


@pytest.mark.parametrize(
    ("frame", "words"),
    [("camera", 'LookupException: "camera" passed to'), ("beacon", "ConnectivityException: Could")],
)
def test_a_frame_that_tf2_does_not_know_is_refused_in_a_line(frames, frame, words):
    with pytest.raises(InvalidMessageError) as raised:
        frames.place(posed(0.0, 0.0, 0.0), frame, "a goal")
    begin = f"wanted a goal in the frame 'map', got one in '{frame}' ({words}"
    assert str(raised.value).startswith(begin) and "\n" not in str(raised.value)


def test_what_tf2_brings_is_checked_as_what_comes_in_the_global_frame(frames):
    turned = posed(math.nan, 0.0, 0.0)
    for frame in ("map", "odom"):
        with pytest.raises(InvalidMessageError, match="wanted a pose at finite metres"):
            frames.place(turned, frame, "a pose")
