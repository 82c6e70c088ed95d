"""Connections of the onboard loop: input, outputs and observers, as options name them."""

from dataclasses import dataclass
from pathlib import Path

from nnpp_edge.runtime.errors import InvalidQueryError

STDIN, REPLAY, ZENOH, STDOUT, NONE = "stdin", "replay", "zenoh", "stdout", "none"


@dataclass(frozen=True)
class Wiring:
    """Connections of the loop.

    Raises
    ------
    InvalidQueryError
        Input or outputs are unknown, or do not go together.
    """

    input: str = STDIN
    """``stdin``, ``replay:FILE``, or ``zenoh`` or ``zenoh:ENDPOINT``."""
    outputs: tuple[str, ...] = ()
    """``stdout``, ``zenoh[:ENDPOINT]`` or ``none``; empty: ``zenoh`` for input from there, else ``stdout``."""
    framing: str = "lines"
    """Of stdin and stdout."""
    zenoh_connect: str | None = None
    """Connect to this endpoint instead of listening."""
    zenoh_prefix: str = "nnpp_edge"
    fast: bool = False
    """Replay at full speed: each tick gets the inputs of one recorded tick, and the next one follows at once."""
    stay: bool = False
    """Go on after stdin is closed or the replay is over."""
    record: Path | None = None
    """Recording of the inputs to write."""
    log: Path | None = None
    """MCAP file to write."""
    metrics_port: int | None = None
    metrics_file: Path | None = None
    view: str | None = None
    """Where rerun shows map and path, as for `RerunSink.at`."""
    trace: Path | None = None
    """Trace of the ticks to write at the end, its newest events."""

    def __post_init__(self) -> None:
        kind, place = kind_and_place(self.input)
        if kind not in (STDIN, REPLAY, ZENOH) or (kind == STDIN and place) or (kind == REPLAY and not place):
            raise InvalidQueryError(f"input must be stdin, replay:FILE or zenoh[:ENDPOINT], got {self.input!r}")
        if self.fast and kind != REPLAY:
            raise InvalidQueryError(f"only a replay can be fast, got input {self.input!r}")
        kinds = self.output_kinds
        if unknown := [output for output in self.outputs if kind_and_place(output)[0] not in (STDOUT, ZENOH, NONE)]:
            raise InvalidQueryError(f"output must be stdout, zenoh[:ENDPOINT] or none, got {unknown[0]!r}")
        if len(set(kinds)) < len(kinds):
            raise InvalidQueryError(f"outputs must differ, got {', '.join(self.outputs)}")
        if NONE in kinds and len(kinds) > 1:
            raise InvalidQueryError(f"output none goes with no other, got {', '.join(self.outputs)}")
        if len(self._endpoints) > 1:
            raise InvalidQueryError(f"input and output must name one endpoint, got {', '.join(self._endpoints)}")

    @property
    def output_kinds(self) -> tuple[str, ...]:
        """The outputs without endpoints."""
        if self.outputs:
            return tuple(kind_and_place(output)[0] for output in self.outputs)
        return (ZENOH if kind_and_place(self.input)[0] == ZENOH else STDOUT,)

    @property
    def uses_zenoh(self) -> bool:
        """Whether a Zenoh session is needed."""
        return ZENOH in (kind_and_place(self.input)[0], *self.output_kinds)

    @property
    def endpoint(self) -> str | None:
        """Zenoh's endpoint, if one is named."""
        return next(iter(self._endpoints), None)

    @property
    def _endpoints(self) -> list[str]:
        named = [kind_and_place(text) for text in (self.input, *self.outputs)]
        return sorted({place for kind, place in named if kind == ZENOH and place})


def kind_and_place(text: str) -> tuple[str, str]:
    """``replay:FILE`` as (``replay``, ``FILE``)."""
    kind, _, place = text.partition(":")
    return kind, place
