"""The outline of a model file, read before onnxruntime sees it: its metadata, and whether its graph
ends.

An ONNX file is a protobuf message. Of it only nodes, the graphs inside them, where tensors lie and
the metadata are looked at, without the onnx package.
"""

from collections.abc import Iterator

from nnpp_edge.runtime.errors import ModelError

_DEEPEST = 8
"""Graphs inside graphs."""
_FIELDS = {
    "model": {7: "graph", 25: "one with functions of its own"},
    "graph": {1: "node", 5: "tensor", 15: "one with sparse tensors"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph"},
    "tensor": {13: "one with tensors in other files", 14: "one with tensors in other files"},
}
"""Of each message the numbers of fields that are looked into, or that speak against it."""
# of ModelProto, StringStringEntryProto
_METADATA = 14
_KEY = 1
_VALUE = 2
# of NodeProto, TensorProto
_OPERATOR = 4
_DATA_LOCATION = 14
_VARINT = 0
_LENGTH = 2
_FIXED_BYTES = {1: 8, 5: 4}
"""Of fields of these kinds."""


def checked_metadata(content: bytes, source: str) -> dict[bytes, bytes]:
    """A model's metadata; ModelError, in the name of `source`, if it might never answer or would
    read other files.

    A node that holds a graph may be an `If` only: loops hold theirs, too, and may run forever.
    Functions of the file's own can double their work with each that calls another. Tensors are in
    the file itself.
    """
    model = memoryview(content)
    try:
        objection = (
            "one in onnxruntime's own format"
            if content[4:8] == b"ORTM"
            else next(_objections(model), "")
        )
        entries = [
            dict(_fields(part))
            for number, part in _fields(model)
            if number == _METADATA and not objection
        ]
        metadata = {bytes(entry.get(_KEY, b"")): bytes(entry.get(_VALUE, b"")) for entry in entries}
    except (IndexError, ValueError) as error:
        raise ModelError(
            f"{source}: wanted an ONNX model, got a file that is none or is cut short"
        ) from error
    if objection:
        raise ModelError(
            f"{source}: wanted an ONNX model that nnpp-edge export might write, got {objection}"
        )
    return metadata


def _objections(
    message: memoryview, kind: str = "model", depth: int = 0, operator: bytes = b"If"
) -> Iterator[str]:
    """Objections to a message of this kind, in so many graphs, inside a node of this operator."""
    if kind == "graph" and operator != b"If":
        yield (
            f"one with the operator {operator.decode('ascii', 'replace')!r}, which may run forever"
        )
    if (depth := depth + (kind == "graph")) > _DEEPEST:
        yield f"one with graphs nested more than {_DEEPEST} deep"
        return
    fields = list(_fields(message))
    looked_at = _FIELDS[kind]
    if kind == "node":
        operator = b" ".join({bytes(part) for number, part in fields if number == _OPERATOR})
    for number, part in fields:
        if (found := looked_at.get(number)) is None:
            continue
        if found in _FIELDS:
            yield from _objections(part, found, depth, operator)
        elif (kind, number) != ("tensor", _DATA_LOCATION) or any(byte & 127 for byte in part):
            yield found


def _fields(message: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Number and content of each field; ValueError or IndexError where the message breaks off."""
    at = 0
    end = len(message)
    while at < end:
        key, at = _varint(message, at)
        kind = key & 7
        start = at
        if kind == _VARINT:
            _, at = _varint(message, at)
        elif kind == _LENGTH:
            length, start = _varint(message, at)
            at = start + length
        elif kind in _FIXED_BYTES:
            at += _FIXED_BYTES[kind]
        else:
            raise ValueError(kind)
        if at > end:
            raise ValueError(at)
        yield key >> 3, message[start:at]


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number of seven bits to a byte, and where the next field begins."""
    value = shift = 0
    while (byte := message[at]) > 127:
        value |= (byte & 127) << shift
        at = at + 1
        shift = shift + 7
        if shift > 63:
            raise ValueError(shift)
    return value | byte << shift, at + 1
