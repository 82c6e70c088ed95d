"""Poses in other frames, against a stand-in of tf2: no wheel has it. `Buffer` has the method and the
errors that tf2_ros documents, `do_transform_pose` is that of tf2_geometry_msgs, on the plane.
"""

import cmath
import math
import sys
from types import ModuleType, SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from nnpp_edge.robot.ros2.frames import Frames
from nnpp_edge.robot.ros2.parameters import Own
from nnpp_edge.runtime.loop.messages import InvalidMessageError
from tests.robot.ros2_cases import posed

ON_MAP = {"odom": (10.0, 5.0, 90.0), "base_link": (9.0, 7.0, 135.0)}
"""Where the frames lie on the map: x, y and yaw."""


class LookupException(Exception):
    """A frame is not known."""


class Buffer:
    """Knows the frames on the map, by the newest of their transforms."""

    def lookup_transform(self, target_frame, source_frame, time):
        assert (target_frame, time.nanoseconds) == ("map", 0)
        if source_frame not in ON_MAP:
            raise LookupException(
                f'"{source_frame}" passed to lookupTransform argument source_frame\ndoes not exist. '
            )
        return ON_MAP[source_frame]


def do_transform_pose(pose, transform):
    x, y, yaw_deg = transform
    at = complex(x, y) + turned(complex(pose.position.x, pose.position.y), yaw_deg)
    turn = pose.orientation
    return posed(at.real, at.imag, yaw_deg + 2.0 * math.degrees(math.atan2(turn.z, turn.w)))


def turned(place, yaw_deg):
    """A place turned about the origin."""
    return place * cmath.rect(1.0, math.radians(yaw_deg))


@pytest.fixture
def frames(monkeypatch):
    """A node's frames by the stand-in."""
    tf2_ros = ModuleType("tf2_ros")
    tf2_ros.Buffer = Buffer
    tf2_ros.TransformListener = lambda buffer, node: None
    geometry = ModuleType("tf2_geometry_msgs")
    geometry.do_transform_pose = do_transform_pose
    monkeypatch.setitem(sys.modules, "tf2_ros", tf2_ros)
    monkeypatch.setitem(sys.modules, "tf2_geometry_msgs", geometry)
    return Frames(SimpleNamespace(own=Own()))


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


def test_a_frame_that_tf2_does_not_know_is_refused_in_a_line(frames):
    with pytest.raises(InvalidMessageError) as raised:
        frames.place(posed(0.0, 0.0, 0.0), "camera", "a goal")
    begin = (
        "wanted a goal in the frame 'map', got one in 'camera' (LookupException: \"camera\" passed"
    )
    assert str(raised.value).startswith(begin) and "\n" not in str(raised.value)


def test_what_tf2_brings_is_checked_as_what_comes_in_the_global_frame(frames):
    nowhere = posed(math.nan, 0.0)
    for frame in ("map", "odom"):
        with pytest.raises(InvalidMessageError, match="wanted a pose at finite metres"):
            frames.place(nowhere, frame, "a pose")
