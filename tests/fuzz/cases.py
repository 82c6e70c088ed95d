"""What all targets share: where a case is checked, and what an oracle finds wrong with it.

A target is a function of random numbers, which decide all of a case, and of a place. It raises for
what is wrong: a `Finding`, an AssertionError, or whatever the code raised itself.
"""

import functools
import traceback
from dataclasses import dataclass
from pathlib import Path


class Finding(AssertionError):
    """What an oracle found: in a few words, by which findings are counted, and in detail."""

    def __init__(self, kind, detail=""):
        super().__init__(f"{kind}\n{detail}")
        self.kind = kind


def kind_of(error):
    """By what words an exception is counted."""
    if isinstance(error, Finding):
        return error.kind
    places = traceback.extract_tb(error.__traceback__)
    *_, ours = [each for each in places if "site-packages" not in each.filename]
    return f"{type(error).__name__} at {Path(ours.filename).name}: {ours.line}"


@functools.lru_cache(maxsize=4)
def _tiny(folder):
    from nnpp_edge.runtime import NetworkModel

    return NetworkModel(folder / "tiny.onnx", threads=1)


@dataclass(frozen=True)
class Place:
    """Where the samples are, and which folder a case may write to."""

    samples: Path
    folder: Path | None = None

    @property
    def model(self):
        """The smallest network, loaded once in a process."""
        return _tiny(self.samples)

    def sample(self, name):
        """A sample's content."""
        return (self.samples / name).read_bytes()
