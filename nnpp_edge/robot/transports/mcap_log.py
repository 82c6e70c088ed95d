"""A log of the loop's inputs and answers, as MCAP with ROS 2 messages: Foxglove and rosbag2 read
it.

Costs become occupancies by the rule of `nnpp_edge.ros.maps`. The frame is ``map``: x = column ·
cell size, y = row · cell size, from the corner of cell (0, 0), as ROS maps lie. A map whose rows
run south is seen mirrored.
"""

import json
import logging
import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

import numpy as np

from nnpp_edge.files import open_new
from nnpp_edge.ros.maps import MapFrame, arc_poses
from nnpp_edge.ros.messages import (
    definition,
    grid_message,
    heights_message,
    path_message,
    pose_message,
    string_message,
)
from nnpp_edge.runtime.arrays import Cells
from nnpp_edge.runtime.errors import OutputError, optional_module
from nnpp_edge.runtime.loop.messages import Goal, Input, Output, PathMessage, Pose
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.reading import refused_as

_LOG = logging.getLogger(__name__)

TOPICS = {
    # at the beginning of each file, and while patches of heights come
    "/map": "nav_msgs/OccupancyGrid",
    "/map_patch": "nav_msgs/OccupancyGrid",  # each patch of costs
    "/elevation_patch": "grid_map_msgs/GridMap",  # each patch of heights, in metres
    "/pose": "geometry_msgs/PoseStamped",  # each
    "/goal": "geometry_msgs/PoseStamped",
    "/path": "nav_msgs/Path",  # each that is not the end of the one before; empty if there is none
    "/answer": "std_msgs/String",  # each tick: the answer as JSON, without path and headings
    "/status": "std_msgs/String",  # each status message as JSON
}
_CHUNK_BYTES = 1 << 16
_FLUSH_EVERY_S = 1.0
_MAP_EVERY_S = 10.0
"""Where heights come, which change the costs around them."""
_LIMIT_BYTES = 512e6


class McapLog:
    """A sink that writes inputs and answers to a file. Any thread may call any method.

    Messages older than a second, or 64 kB, are with the operating system: they survive any end of
    the process, and readers that take an unfinished file (the ``mcap`` tool's ``recover``,
    Foxglove) find them. If nothing more can be written, a warning says so once, later messages are
    counted in `lost`, and the loop goes on.

    The log takes 512 MB of disk at most, or four bytes for each cell of the map, not counting a
    second's messages. A file of half that size is finished and renamed to ``NAME.1.mcap``, in place
    of an earlier one, and a new file is begun: the newest messages are kept.

    Parameters
    ----------
    path : Path
        ``.mcap``; a file of that name is left alone, and ``NAME-2.mcap`` is written. OutputError
        if it cannot be begun.
    state : MapState
        The loop's map (`Navigator.map`), which is written; in cells where it has no cell size.
    """

    name = "mcap"

    def __init__(self, path: Path, state: MapState) -> None:
        self._mcap = optional_module("mcap.writer", "a log", "robot")
        self._limit = 0.5 * max(_LIMIT_BYTES, 4.0 * math.prod(state.shape))
        self._state = state
        self._cell = state.sides_m[0]
        self._lock = threading.Lock()
        self._last_path: Cells | None = None
        self._heights_came = False
        self.lost = 0
        """Messages that were not written because the log had stopped."""
        with refused_as(OutputError, f"{path}: could not be written"):
            self._stream: IO[bytes] | None = open_new(path)
        self.path = Path(self._stream.name)
        with self._stopping_on_error():
            self._begin(self._stream)

    def record(self, message: Input, at_s: float = 0.0) -> None:
        """Write an input. Never raises an OSError."""
        stamp = time.time_ns()
        as_ros = (self._cell, stamp)
        with self._lock:
            if isinstance(message, Pose):
                data = pose_message(message.row, message.col, *as_ros)
                self._write("/pose", stamp, data)
            elif isinstance(message, Goal):
                data = pose_message(message.row + 0.5, message.col + 0.5, *as_ros)
                self._write("/goal", stamp, data)
            else:
                of_heights = message.cost is None
                write = heights_message if of_heights else grid_message
                data = write(message.values, self._frame(message.row, message.col), stamp)
                self._write("/elevation_patch" if of_heights else "/map_patch", stamp, data)
                self._heights_came |= of_heights
            self._tidy()

    def publish(self, message: Output) -> None:
        """Write an answer. Never raises an OSError."""
        now = time.time_ns()
        with self._lock:
            answer = message.summary()
            if isinstance(message, PathMessage):
                answer["path"] = len(message.path)
                del answer["headings_deg"]
                if not is_rest(message.walked, self._last_path):
                    poses = arc_poses(message, self._frame())
                    self._write("/path", now, path_message(poses, now))
                self._last_path = message.walked
            topic = "/answer" if isinstance(message, PathMessage) else "/status"
            self._write(topic, now, string_message(json.dumps(answer)))
            self._tidy()

    def close(self) -> None:
        """Finish the file; nothing is written after it."""
        with self._lock, self._stopping_on_error():
            self._finish()

    def _begin(self, stream: IO[bytes]) -> None:
        """Begin a file with the schemas and the map."""
        self._writer = self._mcap.Writer(stream, chunk_size=_CHUNK_BYTES)
        self._writer.start(profile="ros2")
        schemas = {
            kind: self._writer.register_schema(
                kind.replace("/", "/msg/"), "ros2msg", definition(kind).encode()
            )
            for kind in dict.fromkeys(TOPICS.values())
        }
        self._channels: dict[str, int] = {
            topic: self._writer.register_channel(topic, "cdr", schemas[kind])
            for topic, kind in TOPICS.items()
        }
        self._last_path = None
        self._flushed = time.monotonic()
        self._write_map()
        self._writer.flush()

    def _write_map(self) -> None:
        self._mapped = time.monotonic()
        self._heights_came = False
        now = time.time_ns()
        self._write("/map", now, grid_message(self._state.cost(), self._frame(), now))

    def _frame(self, row: int = 0, col: int = 0) -> MapFrame:
        """Where the cells lie of a part of the map that begins at this one."""
        return MapFrame(self._cell, col * self._cell, row * self._cell)

    def _write(self, topic: str, stamp: int, data: bytes) -> None:
        if self._stream is None:
            self.lost += 1
            return
        with self._stopping_on_error():
            self._writer.add_message(
                self._channels[topic], log_time=stamp, publish_time=stamp, data=data
            )

    def _tidy(self) -> None:
        """Write the map, flush, and begin another file, each when it is time."""
        now = time.monotonic()
        if self._heights_came and now - self._mapped >= _MAP_EVERY_S:
            self._write_map()
        if self._stream is None or now - self._flushed < _FLUSH_EVERY_S:
            return
        self._flushed = now
        with self._stopping_on_error():
            self._writer.flush()
            if self._stream.tell() > self._limit:
                self._finish()
                self.path.replace(self.path.with_suffix(f".1{self.path.suffix}"))
                self._stream = self.path.open("wb")
                self._begin(self._stream)

    def _finish(self) -> None:
        if self._stream is not None:
            self._writer.finish()
            self._stream.close()
            self._stream = None

    @contextmanager
    def _stopping_on_error(self) -> Iterator[None]:
        """Stop the log at an OSError, with a warning; what was written stays."""
        try:
            yield
        except OSError as error:
            _LOG.warning("the log %s stops: %s", self.path, " ".join(str(error).split()))
            self.lost += 1
            stream = self._stream
            self._stream = None
            with suppress(OSError):
                if stream is not None:
                    stream.close()


def is_rest(path: Cells, before: Cells | None) -> bool:
    """Whether a path is the end of the one before."""
    if before is None or (len(before) and not len(path)):
        return False
    return np.array_equal(path, before[-len(path) :])
