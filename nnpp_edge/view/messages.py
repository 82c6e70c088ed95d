"""Messages of the page over its WebSocket. JSON, told apart by `type`."""

from typing import Literal

import msgspec

from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError


class _Message(msgspec.Struct, frozen=True, tag_field="type", forbid_unknown_fields=True, kw_only=True):
    """Common fields of all."""

    number: int = 0
    """Of the question, which its answer repeats."""


class Open(_Message, frozen=True, tag="open"):
    """The first message."""

    pixels: int = 1024
    """Of a side of the map on the screen."""


class Move(_Message, frozen=True, tag="move"):
    """An end is dragged to another cell."""

    end: Literal["start", "goal"]
    to: Cell


class Change(_Message, frozen=True, tag="change"):
    """Other settings, by their names in `Asked`."""

    values: dict[str, bool | float | str | None]


class Layer(_Message, frozen=True, tag="layer"):
    """A layer of the map is wanted."""

    name: Literal["relief", "slope", "cost"]


class Compare(_Message, frozen=True, tag="compare"):
    """A method beside the others."""

    method: str


class Paint(_Message, frozen=True, tag="paint"):
    """An obstacle."""

    part: Rectangle


class Mend(_Message, frozen=True, tag="mend"):
    """Question for the work of mending the path around the newest obstacles."""


class Undo(_Message, frozen=True, tag="undo"):
    """Take the last obstacle away, or all."""

    all: bool = False


Message = Open | Move | Change | Layer | Compare | Paint | Mend | Undo
_DECODER = msgspec.json.Decoder(Message)


def decode(text: str) -> Message:
    """A message of the page; InvalidQueryError for anything else."""
    try:
        message: Message = _DECODER.decode(text)
    except (msgspec.DecodeError, UnicodeEncodeError, RecursionError) as error:
        raise InvalidQueryError(f"a message cannot be read: {error}") from None
    return message
