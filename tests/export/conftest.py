"""The one thread of `tests.networks`."""

from tests.networks import one_thread

__all__ = ["one_thread"]
