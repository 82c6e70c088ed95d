"""Inputs and outputs of the onboard loop as JSON, and where one message ends and the next begins in a stream.

What comes in is checked word by word: a message is taken whole, or refused with one line. See docs/run.md.
"""

import base64
import json
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.messages import (
    Counters,
    Goal,
    Input,
    InvalidMessageError,
    MapPatch,
    Origin,
    Output,
    PathMessage,
    Pose,
    StatusMessage,
)

VERSION = 1
LIMIT_BYTES = 16 << 20
"""Of a message; room for a patch of 1700 × 1700 cells in base64."""
FRAMINGS = ("lines", "length")
_FARTHEST = 2**31
_LATEST_S = 1e12
_EXCERPT = 60
_HEADER = struct.Struct(">I")


class WireError(InvalidMessageError):
    """Bytes that are no message; one line says what was wanted and what came."""


@dataclass(frozen=True)
class Fault:
    """The answer to an input that was refused."""

    error: str
    """Why, in one line."""
    count: int = 1
    """Inputs that were refused so far, this one included."""


def encode(message: Input | Output | Fault) -> bytes:
    """A message as JSON in one line, without its end. Values of patches are base64, so that none changes."""
    if isinstance(message, MapPatch):
        name = "cost" if message.elevation is None else "elevation"
        told: dict[str, Any] = {"type": "patch", "row": message.row, "col": message.col}
        told |= {name: _packed(getattr(message, name)), "keep_known": message.keep_known, "stamp": message.stamp}
    elif isinstance(message, Pose | Goal):
        kind = "pose" if isinstance(message, Pose) else "goal"
        told = {"type": kind, "row": message.row, "col": message.col, "stamp": message.stamp}
    elif isinstance(message, Fault):
        told = {"type": "error", "error": message.error, "count": message.count}
    else:
        told = {"type": "path" if isinstance(message, PathMessage) else "status", **message.summary()}
    return json.dumps(_finite({"v": VERSION, **told}), separators=(",", ":"), default=_plain).encode()


def decode(payload: bytes, limit: int = LIMIT_BYTES) -> Input:
    """The input that a message holds.

    Parameters
    ----------
    payload : bytes
        One JSON object in UTF-8.
    limit : int
        Bytes that it may have.

    Raises
    ------
    WireError
        It is too long, no JSON, of another version, has words that are unknown, or values out of range.
    """
    return input_of(parse(payload, limit))


def input_of(told: dict[str, Any]) -> Input:
    """The input that a JSON object describes; WireError as for `decode`."""
    kind = _kind(told, ("pose", "goal", "patch"))
    known = {"v", "type", "row", "col", "stamp"} | ({"elevation", "cost", "keep_known"} if kind == "patch" else set())
    for key in told:
        if key not in known:
            raise WireError(f"{kind}: wanted no words but {', '.join(sorted(known))}, got {key[:_EXCERPT]!r}")
    row, col = (_number(kind, told, key, _FARTHEST) for key in ("row", "col"))
    stamp = _number(kind, told, "stamp", _LATEST_S, 0.0)
    try:
        if kind == "pose":
            return Pose(float(row), float(col), float(stamp))
        if kind == "goal":
            return Goal(row, col, float(stamp))  # type: ignore[arg-type]  # it refuses fractions
        keep = told.get("keep_known", False)
        if not isinstance(keep, bool):
            raise WireError(f"patch.keep_known: wanted true or false, got {_shown(keep)}")
        values = {name: _values(name, told[name]) for name in ("elevation", "cost") if told.get(name) is not None}
        return MapPatch(row, col, keep_known=keep, stamp=float(stamp), **values)  # type: ignore[arg-type]
    except WireError:
        raise
    except InvalidMessageError as error:
        raise WireError(f"{kind}: {error}") from None


def decode_output(payload: bytes, limit: int = LIMIT_BYTES) -> Output | Fault:
    """The answer that a message holds; for programs that listen to the loop. WireError as for `decode`."""
    told = parse(payload, limit)
    kind = _kind(told, ("path", "status", "error"))
    try:
        if kind == "error":
            return Fault(str(told["error"]), int(told["count"]))
        outcome = Status(told["outcome"])
        if kind == "status":
            known = {field.name for field in fields(Counters)}
            counters = Counters(**{key: value for key, value in told["counters"].items() if key in known})
            return StatusMessage(int(told["tick"]), outcome, str(told["text"]), counters)
        return _path_message(told, outcome)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError, AttributeError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise WireError(f"{kind}: wanted an answer of the loop, got another: {_line(reason)}") from None


def parse(payload: bytes, limit: int = LIMIT_BYTES) -> dict[str, Any]:
    """The JSON object of a message, its version checked; WireError as for `decode`."""
    if len(payload) > limit:
        raise WireError(f"wanted a message of at most {limit} bytes, got {len(payload)}")
    try:
        told = json.loads(payload.decode("utf-8"), parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        if isinstance(error, WireError):
            raise
        raise WireError(f"wanted a JSON object, got {_shown(payload)} ({_line(str(error))})") from None
    if not isinstance(told, dict):
        raise WireError(f"wanted a JSON object, got {_shown(told)}")
    if isinstance(version := told.get("v", VERSION), bool) or version != VERSION:
        raise WireError(f"wanted version {VERSION} of the messages, got {_shown(version)}")
    return told


def framed(payload: bytes, framing: str) -> bytes:
    """A message as it stands in a stream: ended by a newline, or led by its length in 4 bytes, big-endian."""
    return payload + b"\n" if framing == "lines" else _HEADER.pack(len(payload)) + payload


class Framer:
    """Cuts a stream into messages. Of one that is too long the bytes are skipped, not kept.

    Parameters
    ----------
    framing : str
        ``lines`` or ``length``.
    limit : int
        Bytes of a message.
    """

    def __init__(self, framing: str = "lines", limit: int = LIMIT_BYTES) -> None:
        if framing not in FRAMINGS:
            raise WireError(f"framing must be one of {', '.join(FRAMINGS)}, got {framing!r}")
        self._lines, self._limit = framing == "lines", limit
        self._buffer = bytearray()
        self._searched = 0
        self._skip = 0
        """Bytes still to be passed over; with lines, any number means up to the next end of a line."""

    def feed(self, chunk: bytes) -> Iterator[bytes | WireError]:
        """The messages that end in `chunk`, and an error in the place of each that is too long."""
        self._buffer += chunk
        yield from self._cut_lines() if self._lines else self._cut_lengths()

    def end(self) -> Iterator[bytes | WireError]:
        """What is left once the stream has ended: a last line without its end, or an error for a cut message."""
        rest, self._buffer = bytes(self._buffer).strip(), bytearray()
        if self._lines and rest and not self._skip:
            yield rest
        elif not self._lines and (rest or self._skip):
            yield WireError("wanted a whole message, got the end of the stream within one")

    def _cut_lines(self) -> Iterator[bytes | WireError]:
        while (at := self._buffer.find(b"\n", self._searched)) >= 0:
            line = bytes(self._buffer[:at]).strip()
            del self._buffer[: at + 1]
            self._searched = 0
            if self._skip:
                self._skip = 0
            elif at > self._limit:
                yield self._too_long(at)
            elif line:
                yield line
        if len(self._buffer) > self._limit and not self._skip:
            self._skip = 1
            yield self._too_long(len(self._buffer))
        if self._skip:
            self._buffer.clear()
        self._searched = len(self._buffer)

    def _cut_lengths(self) -> Iterator[bytes | WireError]:
        while True:
            passed = min(self._skip, len(self._buffer))
            del self._buffer[:passed]
            self._skip -= passed
            if self._skip or len(self._buffer) < _HEADER.size:
                return
            (length,) = _HEADER.unpack_from(self._buffer)
            if length > self._limit:
                self._skip = _HEADER.size + length
                yield self._too_long(length)
                continue
            end = _HEADER.size + length
            if len(self._buffer) < end:
                return
            message = bytes(self._buffer[_HEADER.size : end])
            del self._buffer[:end]
            yield message

    def _too_long(self, length: int) -> WireError:
        return WireError(f"wanted a message of at most {self._limit} bytes, got {length} or more")


def _path_message(told: dict[str, Any], outcome: Status) -> PathMessage:
    words = ("start_moved", "degraded", "method", "reason", "map_version", "planning_ms")
    rest: dict[str, Any] = {key: told[key] for key in words}
    for key in ("start", "goal"):
        rest[key] = None if told[key] is None else (int(told[key][0]), int(told[key][1]))
    for key in ("cost", "lower_bound"):
        rest[key] = math.inf if told[key] is None else float(told[key])
    cells = np.asarray(told["path"], np.int32).reshape(-1, 2)
    return PathMessage(int(told["tick"]), outcome, Origin(told["origin"]), cells, **rest)


def _kind(told: dict[str, Any], kinds: tuple[str, ...]) -> str:
    kind = told.get("type")
    if not isinstance(kind, str) or kind not in kinds:
        raise WireError(f"type: wanted one of {', '.join(kinds)}, got {_shown(kind)}")
    return kind


def _number(kind: str, told: dict[str, Any], key: str, most: float, *default: float) -> float | int:
    if key not in told and default:
        return default[0]
    value = told.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not -most <= value <= most:
        raise WireError(f"{kind}.{key}: wanted a number within ±{most:g}, got {_shown(value)}")
    return value


def _values(name: str, given: Any) -> NDArray[np.float32]:
    """The cells of a patch, from rows of numbers or from base64."""
    return _unpacked(name, given) if isinstance(given, dict) else _listed(name, given)


def _listed(name: str, rows: Any) -> NDArray[np.float32]:
    wanted = f"patch.{name}: wanted rows of numbers or nulls, all of one length"
    if not isinstance(rows, list) or not rows or not all(isinstance(row, list) and row for row in rows):
        raise WireError(f"{wanted}, got {_shown(rows)}")
    if len({len(row) for row in rows}) > 1:
        raise WireError(f"{wanted}, got lengths {_shown([len(row) for row in rows])}")
    if odd := set().union(*(map(type, row) for row in rows)) - {int, float, type(None)}:
        raise WireError(f"{wanted}, got {', '.join(sorted(kind.__name__ for kind in odd))}")
    try:
        with np.errstate(over="ignore"):
            return np.array([[math.nan if v is None else v for v in row] for row in rows], np.float64).astype(
                np.float32
            )
    except OverflowError:
        raise WireError(f"{wanted}, got one beyond a float's range") from None


def _packed(values: NDArray[np.float32]) -> dict[str, Any]:
    return {"shape": list(values.shape), "float32": base64.b64encode(values.astype("<f4").tobytes()).decode()}


def _unpacked(name: str, given: dict[str, Any]) -> NDArray[np.float32]:
    shape, text = given.get("shape"), given.get("float32")
    wanted = f'patch.{name}: wanted {{"shape": [rows, columns], "float32": base64}}'
    whole = isinstance(shape, list) and len(shape) == 2 and all(type(side) is int and side > 0 for side in shape)
    if not whole or not isinstance(text, str) or len(given) > 2:
        raise WireError(f"{wanted}, got {_shown(given)}")
    try:
        content = base64.b64decode(text, validate=True)
    except ValueError as error:
        raise WireError(f"{wanted}, got text that is not base64 ({_line(str(error))})") from None
    rows, cols = shape  # type: ignore[misc]
    if len(content) != 4 * rows * cols:
        raise WireError(f"{wanted}, got {len(content)} bytes for {rows} × {cols} cells of 4")
    return np.frombuffer(content, "<f4").reshape(rows, cols).astype(np.float32)


def _finite(told: Any) -> Any:
    """The same with null for numbers that JSON lacks."""
    if isinstance(told, dict):
        return {key: _finite(value) for key, value in told.items()}
    return None if isinstance(told, float) and not math.isfinite(told) else told


def _plain(value: Any) -> Any:
    """A NumPy number as Python's."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot be written as JSON: {type(value).__name__}")


def _refuse(word: str) -> Any:
    raise WireError(f"wanted JSON numbers, or null for what was not seen, got {word}")


def _shown(value: Any) -> str:
    """The begin of a value, in one line."""
    if isinstance(value, bytes):
        return repr(value[:_EXCERPT])[1:] + ("…" if len(value) > _EXCERPT else "")
    if isinstance(value, list | dict) and len(value) > 8:
        return f"{'a list' if isinstance(value, list) else 'an object'} of {len(value)}"
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a whole number too long to be written
        return f"a value of type {type(value).__name__}"
    return text if len(text) <= _EXCERPT else text[:_EXCERPT] + "…"


def _line(text: str) -> str:
    return " ".join(text.split())[:200]
