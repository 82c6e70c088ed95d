"""When the parts of a tick ran."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

_NONE: Mapping[str, float] = MappingProxyType({})


class Span(NamedTuple):
    """A part of a tick."""

    name: str
    """``tick``, ``inputs``, ``map``, ``plan`` with its method, ``publish``."""
    began_s: float
    """By the monotonic clock of the loop."""
    ended_s: float
    stages_ms: Mapping[str, float] = _NONE
    """Milliseconds by stage, as `Plan.timings_ms`; empty where there are none."""
