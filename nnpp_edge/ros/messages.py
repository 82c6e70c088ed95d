"""A few ROS 2 messages as their definitions and as CDR bytes, without ROS.

In logs cells become metres as x = (column + ½) · cell size and y = (row + ½) · cell size in the
frame ``map``; z = 0. Arrays are written by NumPy, so that encoding a map or a long path does not
hold up the planning thread: a path of 400 poses takes 0.07 ms, and 6 to 7 ms with rosbags or
mcap-ros2-support, which write each pose by itself.
"""

import math
import struct
from typing import Self

import numpy as np

from nnpp_edge.ros.maps import MapFrame, as_occupancy
from nnpp_edge.runtime.arrays import Float2D, Floats

FRAME = "map"

_RULE = "=" * 80
_PARTS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "nav_msgs/MapMetaData": (
        "builtin_interfaces/Time map_load_time\nfloat32 resolution\nuint32 width\nuint32 height\n"
        "geometry_msgs/Pose origin"
    ),
    "nav_msgs/OccupancyGrid": "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data",
    "nav_msgs/Path": "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses",
    "std_msgs/String": "string data",
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
    "std_msgs/Float32MultiArray": "std_msgs/MultiArrayLayout layout\nfloat32[] data",
    "grid_map_msgs/GridMapInfo": (
        "float64 resolution\nfloat64 length_x\nfloat64 length_y\ngeometry_msgs/Pose pose"
    ),
    "grid_map_msgs/GridMap": (
        "std_msgs/Header header\ngrid_map_msgs/GridMapInfo info\n"
        "string[] layers\nstring[] basic_layers\nstd_msgs/Float32MultiArray[] data\n"
        "uint16 outer_start_index\nuint16 inner_start_index"
    ),
}


def definition(name: str) -> str:
    """A message's definition and those of all it holds, as ROS 2 bags keep them. `name` as in
    ``nav_msgs/Path``.
    """
    found = [name]
    for part in found:  # grows while it is walked
        for line in _PARTS[part].splitlines():
            kind = line.split()[0].removesuffix("[]")
            if kind in _PARTS and kind not in found:
                found.append(kind)
    rest = [f"{_RULE}\nMSG: {part}\n{_PARTS[part]}" for part in found[1:]]
    return "\n".join([_PARTS[name], *rest, ""])


def path_message(poses: Floats, stamp_ns: int, frame_id: str = FRAME) -> bytes:
    """nav_msgs/Path of poses (N, 3 or more), x, y and yaw, as of `maps.path_poses`."""
    cdr = _Cdr(stamp_ns, frame_id).numbers("I", len(poses))
    if len(poses):
        x, y, yaw = poses.T[:3]
        cdr.time(stamp_ns).string(frame_id).pose(x[0], y[0], yaw[0])
        # each further pose begins at a multiple of eight bytes, so all of them are laid out alike
        head = _Cdr(stamp_ns, frame_id).data[4:]
        head += bytes(-len(head) % 8)
        kind = np.dtype([("head", f"V{len(head)}"), ("pose", "<f8", 7)])
        rest = np.zeros(len(poses) - 1, kind)
        rest["head"] = np.void(bytes(head))
        half = 0.5 * yaw[1:]
        rest["pose"][:, 0] = x[1:]
        rest["pose"][:, 1] = y[1:]
        rest["pose"][:, 5] = np.sin(half)
        rest["pose"][:, 6] = np.cos(half)
        cdr.data += rest.tobytes()
    return bytes(cdr.data)


def pose_message(row: float, col: float, cell_size_m: float, stamp_ns: int) -> bytes:
    """geometry_msgs/PoseStamped of a place in cells; (0.5, 0.5) is the middle of the first."""
    return bytes(_Cdr(stamp_ns).pose(col * cell_size_m, row * cell_size_m).data)


def grid_message(cost: Float2D, frame: MapFrame, stamp_ns: int) -> bytes:
    """nav_msgs/OccupancyGrid of costs (h, w) that lie there; rows run with y."""
    cdr = _Cdr(stamp_ns, frame.frame_id or FRAME).time(stamp_ns).numbers("f", frame.resolution)
    cdr.numbers("I", cost.shape[1], cost.shape[0])
    cdr.pose(frame.x, frame.y).numbers("I", cost.size)
    return bytes(cdr.data + as_occupancy(cost).tobytes())


def whole_numbers_message(values: Floats) -> bytes:
    """std_msgs/Int8MultiArray of one dimension."""
    cdr = _Cdr().numbers("I", 0, 0, len(values))  # dimensions, offset
    return bytes(cdr.data + values.astype(np.int8).tobytes())


def heights_message(heights: Float2D, frame: MapFrame, stamp_ns: int) -> bytes:
    """grid_map_msgs/GridMap with the layer ``elevation``, in metres, NaN where unknown, that lies
    there; rows run with y.

    grid_map counts its cells from the corner of largest x and y, x first, and stores columns one
    after another.
    """
    rows, cols = heights.shape
    side = frame.resolution
    cdr = _Cdr(stamp_ns).numbers("d", side, cols * side, rows * side)
    cdr.pose(frame.x + cols / 2 * side, frame.y + rows / 2 * side)
    cdr.numbers("I", 1).string("elevation")  # layers
    cdr.numbers("I", 1).string("elevation")  # basic layers
    cdr.numbers("I", 1, 2)
    cdr.string("column_index").numbers("I", rows, rows * cols)
    cdr.string("row_index").numbers("I", cols, cols)
    cdr.numbers("I", 0, heights.size)
    cdr.data += np.ascontiguousarray(heights[::-1, ::-1], "<f4").tobytes()
    return bytes(cdr.numbers("H", 0, 0).data)


def string_message(text: str) -> bytes:
    return bytes(_Cdr().string(text).data)


class _Cdr:
    """Little-endian CDR: numbers stand at multiples of their own size, counted after the four bytes
    of the head.
    """

    def __init__(self, stamp_ns: int | None = None, frame_id: str = FRAME) -> None:
        self.data = bytearray(b"\x00\x01\x00\x00")
        if stamp_ns is not None:
            self.time(stamp_ns).string(frame_id)

    def numbers(self, form: str, *values: float) -> Self:
        self.data += bytes(-(len(self.data) - 4) % struct.calcsize(form))
        self.data += struct.pack(f"<{len(values)}{form}", *values)
        return self

    def string(self, text: str) -> Self:
        encoded = text.encode() + b"\x00"
        self.numbers("I", len(encoded)).data += encoded
        return self

    def time(self, stamp_ns: int) -> Self:
        return self.numbers("I", *divmod(stamp_ns, 1_000_000_000))

    def pose(self, x: float, y: float, heading: float = 0.0) -> Self:
        half = 0.5 * heading
        return self.numbers("d", x, y, 0.0, 0.0, 0.0, math.sin(half), math.cos(half))
