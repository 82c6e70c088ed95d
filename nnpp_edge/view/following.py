"""A running `nnpp-edge run`, by the answers that it writes as lines: on stdin, or into a file that grows."""

import io
import os
import stat
import time
from collections.abc import Iterator
from contextlib import suppress

from nnpp_edge.robot.transports.wire import LIMIT_BYTES, WireError, decode_output
from nnpp_edge.runtime.loop.messages import PathMessage

_LOOKED_BACK = 1 << 20
"""Bytes before the end of a file from which on its answers are read."""
_PAUSE_S = 0.05
_TOLD = ("tick", "outcome", "reason", "method", "start", "goal", "degraded")


def followed(raw: io.FileIO) -> Iterator[dict[str, object]]:
    """Where the robot is, which way it is to go, and why not: by each answer as it comes, ready for JSON."""
    grows, stream, line = stat.S_ISREG(os.fstat(raw.fileno()).st_mode), io.BufferedReader(raw), b""
    if grows and stream.seek(0, os.SEEK_END) > _LOOKED_BACK:
        stream.seek(-_LOOKED_BACK, os.SEEK_END)
        stream.readline()
    elif grows:
        stream.seek(0)
    while (part := stream.readline(LIMIT_BYTES)) or grows:
        line += part
        if not part:
            time.sleep(_PAUSE_S)
        elif line.endswith(b"\n"):
            with suppress(WireError):  # of a line cut off, or of another program
                if isinstance(answer := decode_output(line), PathMessage):
                    told: dict[str, object] = {name: getattr(answer, name) for name in _TOLD}
                    told["heading_deg"] = next(iter(answer.headings_deg.tolist()), None)
                    yield told | {"line": (answer.path if answer.waypoints is None else answer.waypoints).tolist()}
            line = b""
