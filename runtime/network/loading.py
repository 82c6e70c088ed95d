"""Model files that this process has opened: each is loaded and checked once, for all networks that
share it.

A session that no network uses any more is kept while it is one of the `KEPT` that were asked for
last: planners that are made one after another then load a file once, and a process that opens many
files does not grow.
"""

import os
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from weakref import WeakValueDictionary

from nnpp_edge.runtime.arrays import Planes
from nnpp_edge.runtime.errors import ModelError, NnppEdgeError
from nnpp_edge.runtime.network.model_file import (
    HEAD_KEY,
    QUERY_SPACING,
    UNSEEN,
    ModelMetadata,
    model_path,
    read_metadata,
)
from nnpp_edge.runtime.network.place_head import Matrices, matrices_of
from nnpp_edge.runtime.network.unseen import ANSWERS as ANSWERS_UNSEEN
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.runtime.tuning import TWO_THREADS_FROM

if TYPE_CHECKING:
    from onnxruntime import InferenceSession, IOBinding

OUTPUT = "probability"
PLACES = "places"
"""Names of the output, of a network and of the encoder of one in two parts (`place_head`)."""
_UNSHUFFLE = 4
"""Their map has so many cells, squared, to a pixel, as channels."""
DEFAULT_THREADS = 2
KEPT = 2
"""Sessions kept without a network that uses them."""
Bound = tuple[dict[str, Planes], dict[str, Planes], "IOBinding"]
"""Inputs and outputs of a network, by name, and the binding by which its session uses them."""
Identity = tuple[int, ...]
"""Device, inode, size and times of a file: what tells it from any other, and from what it was
before a change.
"""
Key = tuple[Identity, int | None]
"""File, and threads as asked for."""


@dataclass(eq=False)
class LoadedModel:
    """The common part of networks that share a session."""

    threads: int | None
    """As asked for."""
    session: "InferenceSession"
    metadata: ModelMetadata
    head: Matrices | None
    """Of a network in two parts."""
    idle: deque[Bound] = field(default_factory=lambda: deque(maxlen=KEPT))
    """Left by networks in two parts that are gone, for the next ones."""


_loading = threading.Lock()
"""Held by the thread that loads a file."""
_open: WeakValueDictionary[Key, LoadedModel] = WeakValueDictionary()
_kept: deque[LoadedModel] = deque(maxlen=KEPT)


def opened(path: Path, threads: int | None = None) -> tuple[LoadedModel, bool]:
    """A model file's session, opened if this process has not yet, and whether it had to be waited
    for.

    Arguments and errors are those of `NetworkModel`: whoever asks for a file that cannot be loaded
    tries again.
    """
    key = _identity(path), threads
    loaded = _open.get(key)
    if waited := loaded is None:
        with _loading:
            loaded = _open.get(key)
            if loaded is None:
                _open[key] = loaded = _load(path, key)
    if not _kept or _kept[-1] is not loaded:
        _kept.append(loaded)
    return loaded, waited


def begin_loading(model: object) -> None:
    """Open the file of a model, by its name or path, in the background. Whoever asks for it
    meanwhile waits for it.

    Nothing is done for a model that is loaded already. Errors are left to those who ask.
    """

    def load() -> None:
        with suppress(Exception):
            opened(path)

    if not isinstance(model, str | Path):
        return
    with suppress(NnppEdgeError, RuntimeError):  # the latter where no thread can be started
        path = model_path(model)
        if (_identity(path), None) not in _open:
            # no daemon: a process that ends in the middle of an import of onnxruntime may crash
            threading.Thread(target=load, name="load a model").start()


def _identity(path: Path) -> Identity:
    with refused_as(ModelError, f"{path}: wanted a file to read"):
        found = path.stat()
    # the last cannot be set back, as the one before it can
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _load(path: Path, key: Key) -> LoadedModel:
    """Read, check and open a file."""
    identity, threads = key
    metadata = read_metadata(path)  # which refuses what would never be opened
    count = threads
    if count is None:
        cores = len(os.sched_getaffinity(0))
        count = 1 if metadata.input_size < TWO_THREADS_FROM else min(DEFAULT_THREADS, cores)
    session = open_session(path, count)
    with refused_as(
        ModelError, f"{path}: wanted an ONNX model, got one that does not fit its metadata"
    ):
        values = [*session.get_inputs(), *session.get_outputs()]
        wanted = _shapes(metadata)
        got = {value.name: tuple(value.shape) for value in values}
        if got != wanted:
            raise ModelError(
                f"{path}: wanted inputs and outputs {wanted} by its metadata, got {got}"
            )
        head = None
        if metadata.encoding == "ends":
            text = session.get_modelmeta().custom_metadata_map.get(HEAD_KEY, "")
            head = matrices_of(text, metadata.head)
    if _identity(path) != identity:
        raise ModelError(f"{path}: wanted an ONNX model, got one that changed while it was loaded")
    return LoadedModel(threads, session, metadata, head)


def open_session(path: Path, threads: int) -> "InferenceSession":
    """onnxruntime's session of a file; ModelError where it does not load."""
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # or they take the cores from the search
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4
    with refused_as(ModelError, f"{path}: wanted an ONNX model, got a file that does not load"):
        return ort.InferenceSession(str(path), options, ["CPUExecutionProvider"], enable_fallback=0)


def _shapes(m: ModelMetadata) -> dict[str, tuple[int, ...]]:
    """Of the input and the output, by name, by the metadata."""
    size = m.input_size
    if m.encoding == "unseen":
        return {"input": (1, len(UNSEEN), size, size), OUTPUT: (1, ANSWERS_UNSEEN, size, size)}
    if m.encoding == "gaussian":
        return {"input": (1, 3, size, size), OUTPUT: (1, 1, m.blocks, m.blocks)}
    side = size // _UNSHUFFLE
    places = size // QUERY_SPACING
    return {
        "map": (1, 2 * _UNSHUFFLE**2, side, side),
        PLACES: (1, 2 * m.head[0], places, places),
    }
