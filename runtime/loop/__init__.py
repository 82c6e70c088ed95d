"""The onboard loop: inputs in, a checked path out, at a fixed rate. See docs/onboard.md.

The names below are imported when first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nnpp_edge.runtime.loop.inprocess import InProcessSink, InProcessSource
    from nnpp_edge.runtime.loop.ladder import NavigatorSettings
    from nnpp_edge.runtime.loop.messages import Counters, Goal, MapPatch, Origin, PathMessage, Pose, StatusMessage
    from nnpp_edge.runtime.loop.navigator import Navigator
    from nnpp_edge.runtime.loop.runner import InputSource, Loop, handling_signals
    from nnpp_edge.runtime.loop.sinks import Sink
    from nnpp_edge.runtime.loop.world import World

_MODULES = {
    "inprocess": ("InProcessSink", "InProcessSource"),
    "ladder": ("NavigatorSettings",),
    "messages": ("Counters", "Goal", "MapPatch", "Origin", "PathMessage", "Pose", "StatusMessage"),
    "navigator": ("Navigator",),
    "runner": ("InputSource", "Loop", "handling_signals"),
    "sinks": ("Sink",),
    "world": ("World",),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "Counters",
    "Goal",
    "InProcessSink",
    "InProcessSource",
    "InputSource",
    "Loop",
    "MapPatch",
    "Navigator",
    "NavigatorSettings",
    "Origin",
    "PathMessage",
    "Pose",
    "Sink",
    "StatusMessage",
    "World",
    "handling_signals",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
