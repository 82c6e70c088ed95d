"""Which transports the loop is connected to: options of `nnpp-edge run`, made from `TRANSPORTS`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from nnpp_edge.robot.transports import TransportEntry, entries, find
from nnpp_edge.runtime.errors import InvalidQueryError

if TYPE_CHECKING:
    from nnpp_edge.runtime.loop.connections import Incoming
    from nnpp_edge.runtime.loop.navigator import Navigator

STDOUT = "stdout"
NONE = "none"


def _forms(option: str) -> str:
    return "|".join(entry.form for entry in entries(option))


def _listed(option: str) -> str:
    return ", ".join(f"{entry.help} ({entry.name})" for entry in entries(option))


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """Connections of the loop, as the options of `nnpp-edge run` name them; InvalidQueryError
    where there is no such transport, or some do not go together.
    """

    input: Annotated[
        str,
        {"metavar": _forms("input")},
        f"Where patches, poses and goals come from: {_listed('input')}.",
    ] = "stdin"
    outputs: Annotated[
        tuple[str, ...],
        "--output",
        {"multiple": True, "metavar": f"{_forms('output')}|{NONE}"},
        f"Where paths go: {_listed('output')}, nowhere ({NONE}); may be repeated. By default to "
        "the sender of the inputs, and of a replay to stdout.",
    ] = ()
    fast: Annotated[bool, "Replay one recorded tick a tick, and ticks without a pause."] = False
    zenoh_connect: Annotated[
        str | None,
        {"metavar": "ENDPOINT"},
        "Connect to this router or peer instead of listening.",
    ] = None
    record: Annotated[
        Path | None,
        "Write the inputs to this file, for replay; one that is there stays, and -2 is added.",
    ] = None
    log: Annotated[Path | None, "Write inputs and answers to this .mcap file, likewise."] = None

    def __post_init__(self) -> None:
        name = self.source[0].name
        sinks = {entry.name: place for entry, place in self.sinks}
        given = ", ".join(self.outputs)
        if self.fast and name != "replay":
            raise InvalidQueryError(f"only a replay can be fast, got input {self.input!r}")
        if NONE in self.outputs and len(self.outputs) > 1:
            raise InvalidQueryError(f"output {NONE} goes with no other, got {given}")
        if len(sinks) < len(self.sinks):
            raise InvalidQueryError(f"outputs must differ, got {given}")
        places = {self.source[1], sinks.get(name, "")} - {""}
        if len(places) > 1:  # a transport of both directions is one connection
            named = ", ".join(sorted(places))
            raise InvalidQueryError(f"input and output must name one endpoint, got {named}")

    @property
    def source(self) -> tuple[TransportEntry, str]:
        """The transport that inputs come by, and its place."""
        return find("input", self.input)

    @property
    def sinks(self) -> list[tuple[TransportEntry, str]]:
        """The transports that answers go by."""
        if self.outputs:
            return [find("output", words) for words in self.outputs if words != NONE]
        back = [entry for entry in entries("output") if entry.name == self.source[0].name]
        return [(back[0], "") if back else find("output", STDOUT)]


class Setup(NamedTuple):
    """The loop that a transport is opened for."""

    wiring: Wiring
    navigator: "Navigator"
    source: "Incoming | None" = None
    """The source, once it is open: a sink answers the inputs that were refused there."""
