"""The loop in the rerun viewer, live or as a recording: map, path, pose, goal, latencies."""

import math
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import InvalidQueryError, OutputError, optional_module
from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, Output, PathMessage, Pose
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.reading import refused_as

Colour = tuple[int, int, int]
_PATH = (255, 120, 20)
_DEGRADED = (235, 60, 200)
_BODY = (190, 255, 120)
_ROBOT = (255, 215, 0)
_GOAL = (225, 20, 30)
_PATCH = (0, 200, 230)
_MOST_ARROWS = 100


class RerunSink:
    """A sink for rerun. Columns run to the right and rows down; the map is drawn as in the
    toolkit's pictures.

    Parameters
    ----------
    where : str or Path
        ``here`` starts a viewer on this machine, ``rerun+http://HOST:9876/proxy`` is the address of
        one, and ``….rrd`` is a recording to write; a file of that name is replaced.
    state : MapState
        The loop's map (`Navigator.map`), shown again when it has changed, but at most every
        `map_every_s` seconds.

    InvalidQueryError where `where` is none of these, MissingExtraError without rerun, OutputError
    where the recording cannot be begun or no viewer can be started.
    """

    name = "rerun"

    def __init__(self, where: str | Path, state: MapState, *, map_every_s: float = 1.0) -> None:
        self._rr = optional_module("rerun", "a view", "viz")
        self._state = state
        self._map_every_s = map_every_s
        self._version = -1
        self._mapped = -math.inf
        self._tick = 0
        self._began = time.monotonic()
        self._outcome = ""
        self._stream = self._rr.RecordingStream("nnpp-edge")
        place = str(where)
        is_address = place.startswith(("rerun://", "rerun+http://", "rerun+https://"))
        if not (place == "here" or is_address or place.endswith(".rrd")):
            wanted = "here, rerun+http://HOST:9876/proxy or a file FILE.rrd"
            raise InvalidQueryError(f"view must be {wanted}, got {place!r}")
        with refused_as(OutputError, f"{place}: rerun cannot write there"):
            if place == "here":
                self._stream.spawn()
            elif is_address:
                self._stream.connect_grpc(place)
            else:
                Path(where).open("wb").close()  # rerun reports a missing folder only in its log
                self._stream.save(where)

    def record(self, message: Input, at_s: float = 0.0) -> None:
        """Show an input, with the tick that follows: the robot, its goal, or the rectangle of a map
        patch.
        """
        self._set_time(self._tick + 1)
        rr = self._rr
        if isinstance(message, MapPatch):
            rows, cols = message.shape
            array = [message.col, message.row, cols, rows]
            box = rr.Boxes2D(array=array, array_format=rr.Box2DFormat.XYWH, colors=_PATCH)
            self._stream.log("map/patch", box)
        elif isinstance(message, Goal):
            self._point("map/goal", (message.row + 0.5, message.col + 0.5), _GOAL)
        elif isinstance(message, Pose):
            self._point("map/robot", (message.row, message.col), _ROBOT)
            if message.heading_deg is not None:
                place = np.array([(message.col, message.row)], np.float32)
                self._arrows("map/robot/heading", place, np.array([message.heading_deg]), _ROBOT)

    def publish(self, message: Output) -> None:
        """Show an answer or a status message."""
        self._tick = message.tick
        self._set_time(message.tick)
        rr = self._rr
        if not isinstance(message, PathMessage):
            self._stream.log("status", rr.TextLog(message.text))
            for name in ("p50", "p99", "max"):
                self._scalar(f"tick_ms/{name}", message.counters.tick_ms.get(name))
            self._scalar("memory_mb", 1e-6 * message.counters.rss_bytes)
            return
        self._show_map()
        colour = _DEGRADED if message.degraded else _PATH
        strips = [_points(message.path)] if len(message.path) else []
        self._stream.log(
            "map/path", rr.LineStrips2D(strips, colors=colour, radii=0.4, draw_order=10.0)
        )
        self._show_bodies(message)
        self._scalar("planning_ms", message.planning_ms)
        self._scalar("cost", message.cost if message.ok else None)
        outcome = f"{message.outcome} by {message.origin}" + (
            " (degraded)" if message.degraded else ""
        )
        if outcome != self._outcome:
            self._outcome = outcome
            self._stream.log(
                "status", rr.TextLog(f"{outcome}: {message.reason}" if message.reason else outcome)
            )

    def close(self) -> None:
        """Write the rest and disconnect."""
        self._stream.flush()
        self._stream.disconnect()

    def _set_time(self, tick: int) -> None:
        self._stream.set_time("time", duration=time.monotonic() - self._began)
        self._stream.set_time("tick", sequence=tick)

    def _show_map(self) -> None:
        now = time.monotonic()
        state = self._state
        if state.log.version == self._version or now - self._mapped < self._map_every_s:
            return
        from nnpp_edge.viz.picture import cost_picture

        self._version = state.log.version
        self._mapped = now
        picture = np.ascontiguousarray(cost_picture(state.cost())[..., ::-1])
        self._stream.log("map/cost", self._rr.Image(picture))

    def _show_bodies(self, message: PathMessage) -> None:
        """The outline of the map's vehicle along the path, and its headings where it
        drives arcs.
        """
        vehicle = self._state.vehicle
        sides = self._state.sides_m
        if vehicle is None or sides is None:
            return
        from nnpp_edge.viz.picture import body_outlines

        headings = message.headings_deg
        some = slice(None, None, 1 + len(message.path) // _MOST_ARROWS)
        outlines = body_outlines(message.path, vehicle, sides, headings if message.states else None)
        strips = [_points(outline) for outline in outlines]
        self._stream.log(
            "map/body", self._rr.LineStrips2D(strips, colors=_BODY, radii=0.15, draw_order=15.0)
        )
        if vehicle.turning_radius_m is not None:
            self._arrows("map/headings", _points(message.path)[some], headings[some], _PATH)

    def _arrows(
        self,
        place: str,
        points: NDArray[np.float32],
        headings_deg: NDArray[np.float64],
        colour: Colour,
    ) -> None:
        """Arrows two cells long from points (x, y)."""
        (dy, dx), turns = self._state.sides_m or (1.0, 1.0), np.radians(headings_deg)
        ahead = 2.0 * min(dy, dx) * np.column_stack((np.sin(turns) / dx, -np.cos(turns) / dy))
        arrows = self._rr.Arrows2D(
            vectors=ahead, origins=points, colors=colour, radii=0.15, draw_order=16.0
        )
        self._stream.log(place, arrows)

    def _point(self, place: str, cell: tuple[float, float], colour: Colour) -> None:
        point = self._rr.Points2D([(cell[1], cell[0])], colors=colour, radii=1.2, draw_order=20.0)
        self._stream.log(place, point)

    def _scalar(self, place: str, value: float | None) -> None:
        if value is not None and math.isfinite(value):
            self._stream.log(place, self._rr.Scalars(value))


def _points(path: NDArray[np.generic]) -> NDArray[np.float32]:
    """Middles of cells as (x, y)."""
    return path[:, ::-1].astype(np.float32) + np.float32(0.5)
