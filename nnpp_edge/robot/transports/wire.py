"""Inputs and outputs of the onboard loop as JSON. See docs/messages.md.

An input is taken whole or refused: unknown words, wrong types and values out of range are errors of
one line.
"""

import re
from dataclasses import dataclass
from typing import Annotated, Literal, TypeVar

import msgspec
import numpy as np

from nnpp_edge.runtime import Goal, InvalidMessageError, MapPatch, PathMessage, Pose, StatusMessage
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.loop.messages import Input, Output

T = TypeVar("T")

VERSION = 1
LIMIT_BYTES = 16 << 20
"""Of a message; room for a patch of 1700 × 1700 cells in base64."""
JSON_BYTES = 128 << 10
"""Of a message outside a patch's base64; room for 128 × 128 cells as lists. No other thread runs
while JSON is decoded: 9 ms at most for so much, as for 16 MiB of base64; 16 MiB of lists took 1
s and 1 GB."""
_EXCERPT = 60
_OPENING = re.compile(rb'"float32"\s{0,60}:\s{0,60}"')

_Place = Annotated[float, msgspec.Meta(ge=-(2**31), le=2**31)]
_Stamp = Annotated[float, msgspec.Meta(ge=-1e12, le=1e12)]
_Time = Annotated[float, msgspec.Meta(ge=0.0, le=1e9)]
_Side = Annotated[int, msgspec.Meta(gt=0)]
_Row = Annotated[list[float | None], msgspec.Meta(min_length=1)]
_Rows = Annotated[list[_Row], msgspec.Meta(min_length=1)]


class WireError(InvalidMessageError):
    """Bytes that are no message; one line says what was wanted and what came."""


@dataclass(frozen=True)
class Fault:
    """The answer to an input that was refused."""

    error: str
    """Why, in one line."""
    count: int = 1
    """Inputs that were refused so far, this one included."""


class Record(msgspec.Struct, tag_field="type", forbid_unknown_fields=True, kw_only=True):
    v: Literal[1] = 1
    row: _Place
    col: _Place
    stamp: _Stamp = 0.0
    at: _Time | None = None
    """In a recording: seconds since it began."""


class PoseRecord(Record, tag="pose"):
    heading_deg: float | None = None


class GoalRecord(PoseRecord, tag="goal"):
    """A `Goal` on the wire."""


class Packed(msgspec.Struct, forbid_unknown_fields=True):
    """Values of a patch as base64 of little-endian float32, row by row."""

    shape: tuple[_Side, _Side]
    float32: bytes


class PatchRecord(Record, tag="patch"):
    elevation: _Rows | Packed | None = None
    cost: _Rows | Packed | None = None
    keep_known: bool = False


INPUT_RECORDS = PoseRecord | GoalRecord | PatchRecord
_KINDS = {None: INPUT_RECORDS, "pose": PoseRecord, "goal": GoalRecord, "patch": PatchRecord}
_INPUTS: dict[str | None, msgspec.json.Decoder[Record]] = {
    name: msgspec.json.Decoder(kind) for name, kind in _KINDS.items()
}
_NAMES = {
    Pose: "pose",
    Goal: "goal",
    MapPatch: "patch",
    PathMessage: "path",
    StatusMessage: "status",
    Fault: "error",
}


def encode(message: Input | Output | Fault) -> bytes:
    """Write a message as JSON in one line, without its end. Values of patches are base64, so that
    none changes; numbers that JSON lacks become null.
    """
    fields: object = message
    if isinstance(message, MapPatch):
        layer = "elevation" if message.cost is None else "cost"
        fields = {
            "row": message.row,
            "col": message.col,
            "keep_known": message.keep_known,
            "stamp": message.stamp,
            layer: Packed(message.shape, message.values.astype("<f4").tobytes()),
        }
    elif isinstance(message, PathMessage):
        fields = message.summary()
    head = b'{"v":%d,"type":"%s",' % (VERSION, _NAMES[type(message)].encode())
    return head + _ENCODER.encode(fields)[1:]


def decode(payload: bytes, limit: int = LIMIT_BYTES, kind: str | None = None) -> Input:
    """Read the input that a message holds.

    The message is one JSON object in UTF-8. Where only a `kind` may come, ``pose``, ``goal`` or
    ``patch``, it need not name its type. WireError where it is too long, has more than `JSON_BYTES`
    outside base64, is no JSON, of another version, has words that are unknown, or values out of
    range.
    """
    wanted = f"a {kind or 'pose, goal or patch'}"
    return as_input(decoded(payload, _INPUTS[kind], wanted, limit))


def decoded(payload: bytes, decoder: msgspec.json.Decoder[T], wanted: str, limit: int) -> T:
    """A decoder's result for an input of at most `limit` bytes, of which at most `JSON_BYTES` are
    left without a patch's base64; WireError says what was wanted and what came.
    """
    if len(payload) > limit:
        raise WireError(f"wanted a message of at most {limit} bytes, got {len(payload)}")
    if len(payload) > JSON_BYTES:
        rest = len(payload)
        opening = _OPENING.search(payload, 0, JSON_BYTES)
        if opening:
            rest -= max(payload.find(b'"', opening.end()) - opening.end(), 0)
        if rest > JSON_BYTES:
            raise WireError(
                f"wanted at most {JSON_BYTES} bytes outside a patch's base64 values (float32), got "
                f"{rest}"
            )
    try:
        return decoder.decode(payload)
    except (ValueError, RecursionError) as error:
        raise _refused(wanted, payload, error) from None


def as_input(record: Record) -> Input:
    """The input of a decoded record; WireError if its values make no sense."""
    try:
        fields = msgspec.structs.asdict(record)
        for name in ("v", "at"):
            del fields[name]
        if isinstance(record, PatchRecord):
            for name in ("elevation", "cost"):
                fields[name] = _values(name, fields[name])
            return MapPatch(**fields)
        return Goal(**fields) if isinstance(record, GoalRecord) else Pose(**fields)
    except InvalidMessageError as error:
        raise WireError(str(error)) from None


def _plain(value: object) -> object:
    """Turn NumPy's arrays and numbers into Python's."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"cannot be written as JSON: {type(value).__name__}")


_ENCODER = msgspec.json.Encoder(enc_hook=_plain)


def _values(name: str, given: list[list[float | None]] | Packed | None) -> Float2D | None:
    """The cells of a patch."""
    if given is None:
        return None
    if isinstance(given, Packed):
        rows, cols = given.shape
        came = len(given.float32)
        if came != 4 * rows * cols:
            raise InvalidMessageError(
                f"a patch's {name} has {came} bytes for {rows} × {cols} cells of 4"
            )
        return np.frombuffer(given.float32, "<f4").reshape(rows, cols)
    lengths = {len(row) for row in given}
    if len(lengths) > 1:
        raise InvalidMessageError(
            f"the rows of a patch's {name} must be of one length, got {sorted(lengths)[:8]}"
        )
    with np.errstate(over="ignore"):
        return np.array(given, np.float64).astype(np.float32)  # None becomes NaN


def _refused(wanted: str, payload: bytes, reason: Exception) -> WireError:
    """The error for a message, in one line."""
    excerpt = repr(payload[:_EXCERPT])[1:]
    if len(payload) > _EXCERPT:
        excerpt += "…"
    text, _, place = " ".join(str(reason).split()).partition(" - at `$.")
    key = place.rstrip("`")
    if key == "v":
        wanted = f"version {VERSION} of the messages"
    why = f"{key}: {text[:150]}" if key else text[:150]
    return WireError(f"wanted {wanted}, got {excerpt} ({why})")
