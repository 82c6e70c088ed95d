"""The outline of a model file, read before onnxruntime sees it: its metadata, and whether its graph ends.

An ONNX file is a protobuf message. Of it only nodes, the graphs inside them, where tensors lie and the metadata are
looked at, without the onnx package.
"""

from collections.abc import Iterator

from nnpp_edge.runtime.errors import ModelError

_DEEPEST = 8
"""Graphs inside graphs."""
_GRAPH, _METADATA, _FUNCTIONS = 7, 14, 25  # of ModelProto
_KEY, _VALUE = 1, 2  # of StringStringEntryProto
_NODE, _INITIALIZER, _SPARSE = 1, 5, 15  # of GraphProto
_OPERATOR, _ATTRIBUTE = 4, 5  # of NodeProto
_ATTRIBUTE_GRAPHS, _ATTRIBUTE_TENSORS = (6, 11), (5, 10)  # of AttributeProto
_EXTERNAL_DATA, _DATA_LOCATION = 13, 14  # of TensorProto
_VARINT, _EIGHT_BYTES, _LENGTH, _FOUR_BYTES = 0, 1, 2, 5


def checked_metadata(content: bytes, source: str) -> dict[bytes, bytes]:
    """A model's metadata; ModelError, in the name of `source`, if it might never answer or would read other files.

    A node that holds a graph may be an `If` only: loops hold theirs, too, and may run forever. Functions of the
    file's own can double their work with each that calls another. Tensors are in the file itself.
    """
    metadata: dict[bytes, bytes] = {}
    try:
        found = next(_objections(memoryview(content), metadata), "")
    except (IndexError, ValueError) as error:
        raise ModelError(f"{source}: wanted an ONNX model, got a file that is none or is cut short") from error
    if found:
        raise ModelError(f"{source}: wanted an ONNX model that nnpp-edge export might write, got {found}")
    return metadata


def _objections(model: memoryview, metadata: dict[bytes, bytes]) -> Iterator[str]:
    """What speaks against a model; its metadata are put into `metadata`."""
    if bytes(model[4:8]) == b"ORTM":
        yield "one in onnxruntime's own format"
    for number, part in _fields(model):
        if number == _METADATA:
            entry = {inner: bytes(value) for inner, value in _fields(part)}
            metadata[entry.get(_KEY, b"")] = entry.get(_VALUE, b"")
        elif number == _FUNCTIONS:
            yield "one with functions of its own"
        elif number == _GRAPH:
            yield from _in_graph(part, 1)


def _in_graph(graph: memoryview, depth: int) -> Iterator[str]:
    if depth > _DEEPEST:
        yield f"one with graphs nested more than {_DEEPEST} deep"
        return
    for number, part in _fields(graph):
        if number == _NODE:
            yield from _in_node(part, depth)
        elif number == _INITIALIZER:
            yield from _in_tensor(part)
        elif number == _SPARSE:
            yield "one with sparse tensors"


def _in_node(node: memoryview, depth: int) -> Iterator[str]:
    operators, loops = set(), False
    for number, part in _fields(node):
        if number == _OPERATOR:
            operators.add(bytes(part))
        elif number == _ATTRIBUTE:
            for inner, value in _fields(part):
                if inner in _ATTRIBUTE_GRAPHS:
                    loops = True
                    yield from _in_graph(value, depth + 1)
                elif inner in _ATTRIBUTE_TENSORS:
                    yield from _in_tensor(value)
    if loops and operators != {b"If"}:
        name = b" ".join(operators).decode("ascii", "replace")
        yield f"one with the operator {name!r}, which may run forever"


def _in_tensor(tensor: memoryview) -> Iterator[str]:
    for number, part in _fields(tensor):
        if number == _EXTERNAL_DATA or (number == _DATA_LOCATION and any(byte & 127 for byte in part)):
            yield "one with tensors in other files"


def _fields(message: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Number and content of each field; ValueError or IndexError where the message breaks off."""
    at, end = 0, len(message)
    while at < end:
        key, at = message[at], at + 1
        if key > 127:
            key, at = _varint(message, at - 1)
        kind, start = key & 7, at
        if kind == _VARINT:
            _, at = _varint(message, at)
        elif kind == _LENGTH:
            length, start = message[at], at + 1
            if length > 127:
                length, start = _varint(message, at)
            at = start + length
        elif kind in (_EIGHT_BYTES, _FOUR_BYTES):
            at += 8 if kind == _EIGHT_BYTES else 4
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
        at, shift = at + 1, shift + 7
        if shift > 63:
            raise ValueError(shift)
    return value | byte << shift, at + 1
