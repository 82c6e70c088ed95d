"""Messages as this package writes them, read and written again by rclpy. What they hold:
`test_mcap_log.py`, by their definitions.

More of them: ``NNPP_EDGE_MESSAGES=10000 pytest tests/robot/test_ros2_messages.py``.
"""

import os
from importlib import import_module

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.serialization import deserialize_message, serialize_message

from nnpp_edge.ros import messages
from nnpp_edge.ros.maps import MapFrame
from tests.robot.ros2_types import built

pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # of rosidl's
COUNT = int(os.environ.get("NNPP_EDGE_MESSAGES", "100"))


def kind_of(name):
    built()
    package, _, kind = name.partition("/")
    return getattr(import_module(f"{package}.msg"), kind)


def made(rng, stamp, frame_id):
    """A message of each kind, by the name of its kind."""
    shape = rng.integers(1, 9, 2)
    frame = MapFrame(*rng.uniform(0.01, 10.0, 3), frame_id=frame_id)
    return {
        "nav_msgs/Path": messages.path_message(
            rng.normal(0.0, 100.0, (shape[0] - 1, 3)), stamp, frame_id
        ),
        "nav_msgs/OccupancyGrid": messages.grid_message(rng.random(shape), frame, stamp),
        "std_msgs/Int8MultiArray": messages.whole_numbers_message(rng.integers(-1, 2, shape[1])),
        "geometry_msgs/PoseStamped": messages.pose_message(*rng.random(2), 0.5, stamp),
        "std_msgs/String": messages.string_message(frame_id),
        "grid_map_msgs/GridMap": messages.heights_message(rng.random(shape), frame, stamp),
    }


def test_the_bytes_of_a_message_are_those_that_rclpy_writes():
    rng = np.random.default_rng(5)
    for _ in range(COUNT):
        stamp = int(rng.integers(0, 2**31 * 10**9))
        frame_id = "".join(rng.choice(list("abc/_ö"), rng.integers(1, 9)))
        for name, own in made(rng, stamp, frame_id).items():
            content = serialize_message(deserialize_message(own, kind_of(name)))
            theirs = np.frombuffer(content, np.uint8)
            ours = np.frombuffer(own, np.uint8)
            # bytes between fields are 0 in ours, and anything in theirs
            assert 0 <= len(theirs) - len(ours) < 4
            assert not ours[theirs[: len(ours)] != ours].any()


def test_definitions_have_the_fields_of_rclpys_messages():
    names = {"float64": "double", "float32": "float"}
    for kind, lines in messages._PARTS.items():
        fields = {}
        for each, name, *_ in map(str.split, lines.splitlines()):
            single = each.removesuffix("[]")
            known = names.get(single, single)
            fields[name] = known if single == each else f"sequence<{known}>"
        assert fields == kind_of(kind).get_fields_and_field_types()
