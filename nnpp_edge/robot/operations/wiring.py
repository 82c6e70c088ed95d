"""Connections of the loop, with the words of the options that `nnpp-edge run` makes of them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import click

from nnpp_edge.runtime.errors import InvalidQueryError

STDIN = "stdin"
REPLAY = "replay"
ZENOH = "zenoh"
STDOUT = "stdout"
NONE = "none"
_OUTPUTS = (
    "Where paths go; may be repeated. By default to the sender of the inputs, and of a "
    "replay to stdout."
)

View = Annotated[
    str | None,
    {"metavar": "WHERE"},
    "Map and path in rerun: 'here' starts a viewer, rerun+http://HOST:9876/proxy is one, FILE.rrd "
    "is written.",
]


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """Connections of the loop; InvalidQueryError where input or outputs are unknown, or do not go
    together.
    """

    input: Annotated[
        str,
        {"metavar": "stdin|replay:FILE|zenoh[:ENDPOINT]"},
        "Where patches, poses and goals come from.",
    ] = STDIN
    outputs: Annotated[
        tuple[str, ...],
        "--output",
        {"multiple": True, "metavar": "stdout|zenoh[:ENDPOINT]|none"},
        _OUTPUTS,
    ] = ()
    fast: Annotated[bool, "Replay one recorded tick a tick, and ticks without a pause."] = False
    stay: Annotated[bool, "Go on when stdin is closed or the replay is over."] = False
    zenoh_connect: Annotated[
        str | None, {"metavar": "ENDPOINT"}, "Connect to this router or peer instead of listening."
    ] = None
    zenoh_prefix: Annotated[str, "First part of all topics."] = "nnpp_edge"
    record: Annotated[
        Path | None,
        "Write the inputs to this file, for replay; one that is there stays, and -2 is added.",
    ] = None
    log: Annotated[Path | None, "Write inputs and answers to this .mcap file, likewise."] = None
    metrics: Annotated[
        int | None,
        click.IntRange(0, 65535),
        {"metavar": "PORT"},
        "Serve the counters to Prometheus at this port.",
    ] = None
    view: View = None

    def __post_init__(self) -> None:
        kind, place = self.input_kind
        kinds = self.output_kinds
        endpoints = self.endpoints
        if (
            kind not in (STDIN, REPLAY, ZENOH)
            or (kind == STDIN and place)
            or (kind == REPLAY and not place)
        ):
            raise InvalidQueryError(
                f"input must be stdin, replay:FILE or zenoh[:ENDPOINT], got {self.input!r}"
            )
        if self.fast and kind != REPLAY:
            raise InvalidQueryError(f"only a replay can be fast, got input {self.input!r}")
        for output, its_kind in zip(self.outputs, kinds, strict=False):
            if its_kind not in (STDOUT, ZENOH, NONE):
                raise InvalidQueryError(
                    f"output must be stdout, zenoh[:ENDPOINT] or none, got {output!r}"
                )
        if len(set(kinds)) < len(kinds):
            raise InvalidQueryError(f"outputs must differ, got {', '.join(self.outputs)}")
        if NONE in kinds and len(kinds) > 1:
            raise InvalidQueryError(
                f"output none goes with no other, got {', '.join(self.outputs)}"
            )
        if len(endpoints) > 1:
            raise InvalidQueryError(
                f"input and output must name one endpoint, got {', '.join(endpoints)}"
            )

    @property
    def input_kind(self) -> tuple[str, str]:
        """``replay:FILE`` as (``replay``, ``FILE``)."""
        kind, _, place = self.input.partition(":")
        return kind, place

    @property
    def output_kinds(self) -> tuple[str, ...]:
        """The outputs without endpoints."""
        if self.outputs:
            return tuple(output.partition(":")[0] for output in self.outputs)
        return (ZENOH if self.input_kind[0] == ZENOH else STDOUT,)

    @property
    def endpoints(self) -> list[str]:
        """Zenoh's, those that are named."""
        named = (text.partition(":") for text in (self.input, *self.outputs))
        return sorted({place for kind, _, place in named if kind == ZENOH and place})
