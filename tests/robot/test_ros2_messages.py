"""Messages as this package writes them, beside those that rclpy serializes.

More of them: ``NNPP_EDGE_MESSAGES=10000 pytest tests/robot/test_ros2_messages.py``.
"""

import os
import sys

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.serialization import deserialize_message, serialize_message

from nnpp_edge.ros.maps import MapFrame
from nnpp_edge.ros.messages import (
    grid_message,
    heights_message,
    path_message,
    pose_message,
    string_message,
    whole_numbers_message,
)
from tests.robot.ros2_types import built

pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # of rosidl's
COUNT = int(os.environ.get("NNPP_EDGE_MESSAGES", "100"))


@pytest.fixture(scope="module", autouse=True)
def types():
    sys.path.insert(0, str(built()))
    yield
    sys.path.remove(str(built()))


def header(stamp_ns, frame_id):
    from builtin_interfaces.msg import Time
    from std_msgs.msg import Header

    seconds, rest = divmod(stamp_ns, 10**9)
    return Header(stamp=Time(sec=seconds, nanosec=rest), frame_id=frame_id)


def posed(x, y, yaw=0.0):
    from geometry_msgs.msg import Point, Pose, Quaternion

    turn = Quaternion(z=float(np.sin(0.5 * yaw)), w=float(np.cos(0.5 * yaw)))
    return Pose(position=Point(x=float(x), y=float(y)), orientation=turn)


def a_path(rng, stamp, frame_id):
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import Path

    poses = rng.normal(0.0, 100.0, (int(rng.integers(0, 6)), 3))
    own = header(stamp, frame_id)
    stamped = [PoseStamped(header=own, pose=posed(*pose)) for pose in poses]
    return Path(header=own, poses=stamped), path_message(poses, stamp, frame_id)


def an_occupancy_grid(rng, stamp, frame_id):
    from nav_msgs.msg import MapMetaData, OccupancyGrid

    cost = rng.integers(0, 99, rng.integers(1, 9, 2)) / 100.0
    side, x, y = rng.uniform(0.01, 10.0, 3)
    info = MapMetaData(resolution=side, width=cost.shape[1], height=cost.shape[0])
    info.map_load_time = header(stamp, "").stamp
    info.origin = posed(x, y)
    data = np.rint(100.0 * cost).astype(np.int8).ravel()
    message = OccupancyGrid(header=header(stamp, frame_id), info=info, data=data.tolist())
    return message, grid_message(cost, MapFrame(side, x, y, frame_id=frame_id), stamp)


def whole_numbers(rng, stamp, frame_id):
    from std_msgs.msg import Int8MultiArray

    gears = rng.integers(-1, 2, rng.integers(0, 9))
    return Int8MultiArray(data=gears.tolist()), whole_numbers_message(gears)


def a_pose(rng, stamp, frame_id):
    from geometry_msgs.msg import PoseStamped

    row, col = rng.uniform(0.0, 100.0, 2)
    message = PoseStamped(header=header(stamp, "map"), pose=posed(0.5 * col, 0.5 * row))
    return message, pose_message(row, col, 0.5, stamp)


def a_string(rng, stamp, frame_id):
    from std_msgs.msg import String

    return String(data=frame_id), string_message(frame_id)


def a_grid_map(rng, stamp, frame_id):
    from grid_map_msgs.msg import GridMap as Message
    from std_msgs.msg import Float32MultiArray, MultiArrayDimension

    heights = rng.normal(0.0, 5.0, rng.integers(1, 9, 2)).astype(np.float32)
    rows, cols = heights.shape
    row, col = map(int, rng.integers(-5, 50, 2))
    message = Message(header=header(stamp, "map"), layers=["elevation"], basic_layers=["elevation"])
    message.info.resolution = 0.5
    message.info.length_x = 0.5 * cols
    message.info.length_y = 0.5 * rows
    message.info.pose = posed(0.5 * (col + cols / 2), 0.5 * (row + rows / 2))
    layer = Float32MultiArray(data=heights[::-1, ::-1].ravel().tolist())
    layer.layout.dim = [
        MultiArrayDimension(label="column_index", size=rows, stride=rows * cols),
        MultiArrayDimension(label="row_index", size=cols, stride=cols),
    ]
    message.data = [layer]
    return message, heights_message(heights, MapFrame(0.5, 0.5 * col, 0.5 * row), stamp)


@pytest.mark.parametrize(
    "made", [a_path, an_occupancy_grid, whole_numbers, a_pose, a_string, a_grid_map]
)
def test_the_bytes_of_a_message_are_those_that_rclpy_writes(made):
    rng = np.random.default_rng(5)
    for _ in range(COUNT):
        stamp = int(rng.integers(0, 2**31 * 10**9))
        frame_id = "".join(rng.choice(list("abc/_ö"), rng.integers(0, 9)))
        message, own = made(rng, stamp, frame_id or "m")  # without a name it would be map
        content = serialize_message(message)
        read = [deserialize_message(each, type(message)) for each in (own, content)]
        assert read[0] == read[1]
        theirs = np.frombuffer(content, np.uint8)
        ours = np.frombuffer(own, np.uint8)
        # bytes between fields are 0 in ours, and anything in theirs
        assert 0 <= len(theirs) - len(ours) < 4
        assert not ours[theirs[: len(ours)] != ours].any()
