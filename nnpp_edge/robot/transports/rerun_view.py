"""The loop in the rerun viewer, live or recorded: map, path, body, robot, goal, times of ticks."""

from collections.abc import Sequence
from pathlib import Path

from nnpp_edge.robot.transports.wiring import Setup
from nnpp_edge.runtime.errors import InvalidQueryError, OutputError, optional_module
from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, Output, PathMessage
from nnpp_edge.runtime.map.along import Line
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.viz.picture import body_outlines, cost_picture


class RerunSink:
    """Shows inputs and answers on the loop's map. `where` is as for ``--view``; InvalidQueryError
    for other words, OutputError where nothing can be shown there.
    """

    name = "rerun"

    def __init__(self, where: str, state: MapState) -> None:
        self._rr = optional_module("rerun", "a view", "rerun")
        self._stream = self._rr.RecordingStream("nnpp-edge")
        self._state = state
        self._shown_version = -1
        self._tick = 0
        with refused_as(OutputError, f"{where}: rerun cannot write there"):
            if where == "here":
                self._stream.spawn()
            elif where.startswith(("rerun://", "rerun+http://", "rerun+https://")):
                self._stream.connect_grpc(where)
            elif where.endswith(".rrd"):
                Path(where).open("wb").close()  # rerun reports a missing folder only in its log
                self._stream.save(where)
            else:
                wanted = "here, rerun+http://HOST:9876/proxy or a file FILE.rrd"
                raise InvalidQueryError(f"view must be {wanted}, got {where!r}")

    @classmethod
    def open(cls, place: str, setup: Setup) -> "RerunSink":
        return cls(place, setup.navigator.map)

    def record(self, message: Input, at_s: float = 0.0) -> None:
        """Show the robot or its goal, with the tick that follows. Patches are seen on the map."""
        self._stream.set_time("tick", sequence=self._tick + 1)
        if not isinstance(message, MapPatch):
            name, middle = ("goal", 0.5) if isinstance(message, Goal) else ("robot", 0.0)
            place = (message.col + middle, message.row + middle)
            self._stream.log(f"map/{name}", self._rr.Points2D([place], radii=1.2, draw_order=20.0))

    def publish(self, message: Output) -> None:
        """Show an answer; of a status message its text, and the map if it has changed."""
        self._tick = message.tick
        self._stream.set_time("tick", sequence=message.tick)
        if isinstance(message, PathMessage):
            self._draw("path", [message.path] if message.ok else [])
            if self._state.vehicle is not None:
                kind = (self._state.vehicle, self._state.sides_m or (1.0, 1.0))
                self._draw("body", body_outlines(message.path, *kind, message.headings_deg))
            self._stream.log("planning_ms", self._rr.Scalars(message.planning_ms))
        else:
            self._stream.log("status", self._rr.TextLog(message.text))
        version = self._state.log.version
        due = self._shown_version < 0 or not isinstance(message, PathMessage)
        if due and version != self._shown_version:
            self._shown_version = version
            picture = cost_picture(self._state.cost())
            self._stream.log("map/cost", self._rr.Image(picture, color_model="BGR"))

    def _draw(self, name: str, lines: Sequence[Line]) -> None:
        strips = [line[:, ::-1] + 0.5 for line in lines]
        self._stream.log(f"map/{name}", self._rr.LineStrips2D(strips, draw_order=10.0))

    def close(self) -> None:
        """Write the rest and disconnect."""
        self._stream.flush()
        self._stream.disconnect()
