"""The small data set and network of `tests.networks`."""

from tests.networks import dataset, one_thread, samples, trained

__all__ = ["dataset", "one_thread", "samples", "trained"]
