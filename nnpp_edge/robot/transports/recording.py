"""Inputs of the loop in a file: recorded as they come, and played again.

A line holds one message in JSON, as on the wire, with ``at``: seconds since the recording began.
Inputs that were read in the same tick have the same time. The first line may hold the size of the
map.
"""

import json
import logging
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Literal

import msgspec

from nnpp_edge.files import open_new
from nnpp_edge.robot.transports.wire import (
    INPUT_RECORDS,
    LIMIT_BYTES,
    VERSION,
    Record,
    WireError,
    as_input,
    decoded,
    encode,
)
from nnpp_edge.robot.transports.wiring import Setup
from nnpp_edge.runtime.cells import Shape
from nnpp_edge.runtime.errors import InvalidQueryError, OutputError, one_line
from nnpp_edge.runtime.loop.connections import InputSource, Recorder
from nnpp_edge.runtime.loop.messages import Input, MapPatch
from nnpp_edge.runtime.loop.workers import BoundedQueue, CountError, Guard, WhenFull, Worker
from nnpp_edge.runtime.reading import refused_as

_LOG = logging.getLogger(__name__)
_MOST_WAITING = 4096
_CELLS_AS_ONE = 4096
"""A patch counts as one waiting input, and one more for each so many cells."""
_LONGEST_LINE = LIMIT_BYTES + 64
_PATIENCE_S = 2.0

Timed = tuple[float, Input]
"""Seconds since the recording began, and an input."""


class _Head(msgspec.Struct, tag_field="type", tag="recording"):
    v: Literal[1] = 1
    map: Shape | None = None


_LINE: msgspec.json.Decoder[_Head | Record] = msgspec.json.Decoder(_Head | INPUT_RECORDS)


class ReplayError(InvalidQueryError):
    """A recording that cannot be played; the message names the file and the line."""


class ReplaySource:
    """Plays a recording. It is read once at the beginning, so that errors in it are raised then
    (ReplayError).

    A last line that was cut off, as by a crash, is left out. It must have been recorded on a map of
    this `shape`, where one is given. `fast` gives the inputs of one recorded tick with each call,
    instead of keeping the recorded pace.
    """

    def __init__(self, path: Path, *, shape: Shape | None = None, fast: bool = False) -> None:
        self._fast = fast
        for _ in read_recording(path, shape):  # to its end, for what is wrong there
            pass
        self._rest = read_recording(path, shape)
        self._next = next(self._rest, None)
        self._began: float | None = None
        self.failure = ""
        """Why the rest cannot be played; empty while all is well."""

    @classmethod
    def open(cls, place: str, setup: Setup) -> "ReplaySource":
        return cls(Path(place), shape=setup.navigator.map.shape, fast=setup.wiring.fast)

    @property
    def ended(self) -> bool:
        """Whether all of it was played."""
        return self._next is None

    def poll(self) -> Iterator[Input]:
        """The inputs that are due, or with `fast` those of the next recorded tick."""
        now = time.monotonic()
        if self._began is None:
            self._began = now
        due = now - self._began
        if self._fast and self._next is not None:
            due, _ = self._next
        while self._next is not None and self._next[0] <= due:
            _, message = self._next
            self._next = None
            try:
                self._next = next(self._rest, None)
            except Exception as error:  # it is another file by now
                self.failure = one_line(error)
            yield message

    def close(self) -> None:
        """Close the file."""
        self._rest.close()


def read_recording(path: Path, shape: Shape | None = None) -> Generator[Timed, None, None]:
    """Read times and inputs of a recording, one by one; ReplayError as for `ReplaySource`."""
    latest = 0.0
    wanted = f"{path}: wanted a recording, got a file that cannot be read"
    with refused_as(ReplayError, wanted), Path(path).open("rb") as file:
        lines = iter(partial(file.readline, _LONGEST_LINE + 1), b"")
        for number, line in enumerate(lines, 1):
            if not line.strip():
                continue
            try:
                found = _read_line(line, shape, latest)
            except WireError as error:
                if line.endswith(b"\n") or len(line) > _LONGEST_LINE:
                    raise ReplayError(f"{path}: line {number}: {error}") from None
                _LOG.warning("%s: line %d was cut off, and is left out", path, number)
                return
            if found is not None:
                latest = found[0]
                yield found


def _read_line(line: bytes, shape: Shape | None, latest: float) -> Timed | None:
    """Time and input of a line; None for the head."""
    record = decoded(line, _LINE, "a pose, goal or patch with its time", _LONGEST_LINE)
    if isinstance(record, _Head):
        if shape is not None and record.map not in (None, shape):
            raise WireError(
                f"wanted a recording on a map of {list(shape)} cells, got one of {list(record.map)}"
            )
        return None
    if record.at is None:
        raise WireError("at: wanted the seconds since the recording began, got none")
    if record.at < latest:
        raise WireError(f"at: wanted times that do not go back, got {record.at} after {latest}")
    return record.at, as_input(record)


class RecordingFile:
    """Writes inputs to a new file, line by line: what was written survives the end of the process,
    however it ends.

    A file of that name is left alone: ``scene-2.jsonl`` is written instead of ``scene.jsonl``. The
    `shape` is that of the map. OutputError if the file cannot be written.
    """

    def __init__(self, path: Path, shape: Shape) -> None:
        self._full = False
        """A line could not be written whole: none may follow it."""
        with refused_as(OutputError, f"{path}: could not be written"):
            self._file = open_new(path, buffering=0)
        self.path = Path(self._file.name)
        head = {"v": VERSION, "type": "recording", "map": shape}
        with suppress(OSError):  # the disk is full: `record` will say so
            self._write(json.dumps(head).encode() + b"\n")

    def record(self, message: Input, at_s: float) -> None:
        """Write an input that came so many seconds after the begin; OSError once the disk has been
        full.
        """
        self._write(b'{"at":%.6f,' % at_s + encode(message)[1:] + b"\n")

    def _write(self, line: bytes) -> None:
        if self._full:
            raise OSError(f"{self.path} could not be written to before")
        self._full = True
        if self._file.write(line) < len(line):
            raise OSError(f"{self.path} is cut off: no space is left")
        self._full = False

    def close(self) -> None:
        self._file.close()


class RecordedSource:
    """Passes on the inputs of another source, and hands them to recorders, each in a thread of its
    own.

    Recorders get an input, and the seconds from the first call of `poll` to the one that gave the
    input. If 4096 inputs or 16 million cells wait to be recorded, the next are left out, unless
    `wait` has the loop wait for its recorders, for replays. `count_error` is called with ``record``
    for each input that a recorder failed on, or that was left out. The first failure of a recorder
    is logged.
    """

    def __init__(
        self,
        source: InputSource,
        recorders: Sequence[Recorder],
        count_error: CountError,
        *,
        wait: bool = False,
    ) -> None:
        self._source = source
        self._count_error = count_error
        self._wait = wait
        self._began: float | None = None
        self._workers = []
        for recorder in recorders:
            guard = Guard("recording an input", "record", count_error)
            waiting = BoundedQueue(_MOST_WAITING, _size, patient=lambda: wait)
            worker = Worker(partial(_record, recorder), waiting, guard)
            self._workers.append(worker)
            worker.start()

    def poll(self) -> Iterator[Input]:
        """The inputs of the source."""
        now = time.monotonic()
        if self._began is None:
            self._began = now
        when_full: WhenFull = "wait" if self._wait else "refuse"
        for message in self._source.poll():
            for worker in self._workers:
                if worker.queue.put((now - self._began, message), when_full):
                    self._count_error("record")
            yield message

    def close(self) -> None:
        """Let the waiting inputs be recorded, for two seconds at most, or with `wait` all of
        them.
        """
        for worker in self._workers:
            worker.close(_PATIENCE_S)


def _record(recorder: Recorder, timed: Timed) -> None:
    at_s, message = timed
    recorder.record(message, at_s)


def _size(timed: Timed) -> int:
    """How much room a waiting input takes, in inputs."""
    message = timed[1]
    if not isinstance(message, MapPatch):
        return 1
    return 1 + message.values.size // _CELLS_AS_ONE
