"""Where the loop's inputs come from and its answers go. A new way is a file here and an entry of
`TRANSPORTS`.
"""

import re
from pkgutil import resolve_name
from typing import TYPE_CHECKING, NamedTuple

from nnpp_edge.runtime.errors import InvalidQueryError

if TYPE_CHECKING:
    from nnpp_edge.robot.transports.wiring import Setup
    from nnpp_edge.runtime.loop.connections import Transport


class TransportEntry(NamedTuple):
    """A transport as `nnpp-edge run` offers it."""

    option: str
    """The option that opens it, without hyphens."""
    form: str
    """How users write it: a name, and after a colon its place, in brackets where it may be left
    out.
    """
    help: str
    """A few words on it."""
    kind: str
    """``file:Class``; its ``open(place, setup)`` makes one. Imported when it is opened, as it may
    need libraries that are not installed.
    """

    @property
    def name(self) -> str:
        """The form without its place."""
        return re.split(r"\[?:", self.form)[0]

    def takes(self, place: str) -> bool:
        """Whether this place, or none, may follow the name."""
        if "[" in self.form:
            return True
        return (":" in self.form) == bool(place)

    def open(self, place: str, setup: "Setup") -> "Transport":
        """Make the transport, an `Incoming` or a `Sink`.

        InvalidQueryError where the place makes no sense, OutputError where it cannot be written
        to, MissingExtraError without the transport's library.
        """
        transport: Transport = resolve_name(f"{__name__}.{self.kind}").open(place, setup)
        return transport


TRANSPORTS = (
    TransportEntry("input", "stdin", "lines of JSON on standard input", "stdio:StdioSource"),
    TransportEntry("input", "replay:FILE", "a recording", "recording:ReplaySource"),
    TransportEntry("input", "zenoh[:ENDPOINT]", "topics of Zenoh", "zenoh_io:ZenohSource"),
    TransportEntry("output", "stdout", "lines of JSON on standard output", "stdio:StdioSink"),
    TransportEntry("output", "zenoh[:ENDPOINT]", "topics of Zenoh", "zenoh_io:ZenohSink"),
)


def entries(option: str) -> list[TransportEntry]:
    """The transports that an option opens."""
    return [entry for entry in TRANSPORTS if entry.option == option]


def find(option: str, words: str) -> tuple[TransportEntry, str]:
    """The transport that ``NAME:PLACE`` names, and the place; InvalidQueryError lists the names."""
    name, _, place = words.partition(":")
    for entry in entries(option):
        if entry.name == name and entry.takes(place):
            return entry, place
    forms = [entry.form for entry in entries(option)]
    if option == "output":
        forms.append("none")
    *most, last = forms
    raise InvalidQueryError(f"{option} must be {', '.join(most)} or {last}, got {words!r}")
