"""Model files that this process has opened: each is loaded and checked once, for all networks that
share it.

A session that no network uses any more is kept while it is one of the `KEPT` that were asked for
last: planners that are made one after another then load a file once, and a process that opens many
files does not grow.
"""

import ctypes
import os
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from weakref import WeakValueDictionary

import numpy as np

from nnpp_edge.runtime.arrays import Planes
from nnpp_edge.runtime.errors import ModelError, NnppEdgeError
from nnpp_edge.runtime.kernels.encoding import ENDS_CHANNELS
from nnpp_edge.runtime.kernels.place_head import ANSWERS
from nnpp_edge.runtime.network.model_file import (
    QUERY_SPACING,
    UNSEEN,
    ModelMetadata,
    model_path,
    read_metadata,
)
from nnpp_edge.runtime.network.place_head import PlaceHead, count_parameters
from nnpp_edge.runtime.network.unseen import ANSWERS as ANSWERS_UNSEEN
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.runtime.tuning import TWO_THREADS_FROM

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

OUTPUT = "probability"
PLACES = "places"
HEAD = "head"
ASK = "ask"
"""Names of the output, in networks in two parts (`place_head`) of two more, and of the input that
asks the head.
"""
_UNSHUFFLE = 4
"""Their map has so many cells, squared, to a pixel, as channels."""
DEFAULT_THREADS = 2
KEPT = 2
"""Sessions kept without a network that uses them."""
_ROUNDING = 1e-4
"""Most that the head's answer may differ from its graph's, which adds in another order."""
Shapes = dict[str, tuple[int, ...]]
Identity = tuple[int, ...]
"""Device, inode, size and times of a file: what tells it from any other, and from what it was
before a change.
"""
Key = tuple[Identity, int | None, int]
"""File and threads as asked for, and without a number of threads the cores that it depends on."""


@dataclass(eq=False)
class LoadedModel:
    """The common part of networks that share a session."""

    identity: Identity
    threads: int | None
    """As asked for."""
    parallel: bool
    """Whether the session has threads of its own."""
    session: "InferenceSession"
    metadata: ModelMetadata
    inputs: Shapes
    outputs: Shapes
    head_parameters: Planes | None
    """Of a network in two parts."""
    process: int
    """That opened it."""

    def lacks_threads(self) -> bool:
        """Whether its session waits for threads that another process has, from which this one was
        forked.
        """
        return self.parallel and self.process != os.getpid()


_loading = threading.RLock()
"""Held by the thread that loads a file, and by one that forks: no child begins with a file half
loaded.
"""
_open: WeakValueDictionary[Key, LoadedModel] = WeakValueDictionary()
_kept: deque[LoadedModel] = deque(maxlen=KEPT)


def opened(path: Path, threads: int | None = None) -> tuple[LoadedModel, bool]:
    """A model file's session, opened if this process has not yet, and whether it had to be waited
    for.

    Arguments and errors are those of `NetworkModel`: whoever asks for a file that cannot be loaded
    tries again.
    """
    key = _key(path, threads)
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
        if _key(path, None) not in _open:
            # no daemon: a process that ends in the middle of an import of onnxruntime may crash
            threading.Thread(target=load, name="load a model").start()


def _key(path: Path, threads: int | None) -> Key:
    cores = min(DEFAULT_THREADS, len(os.sched_getaffinity(0))) if threads is None else 0
    return _identity(path), threads, cores


def _identity(path: Path) -> Identity:
    with refused_as(ModelError, f"{path}: wanted a file to read"):
        found = path.stat()
    # the last cannot be set back, as the one before it can
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _load(path: Path, key: Key) -> LoadedModel:
    """Read, check and open a file."""
    identity, threads, cores = key
    metadata = read_metadata(path)  # which refuses what would never be opened
    count = threads
    if count is None:
        count = 1 if metadata.input_size < TWO_THREADS_FROM else cores
    session = open_session(path, count)
    inputs, outputs = _shapes(metadata)
    with refused_as(
        ModelError, f"{path}: wanted an ONNX model, got one that does not fit its metadata"
    ):
        values = [*session.get_inputs(), *session.get_outputs()]
        wanted = inputs | outputs
        got = {value.name: tuple(value.shape) for value in values}
        if got != wanted:
            raise ModelError(
                f"{path}: wanted inputs and outputs {wanted} by its metadata, got {got}"
            )
        head = None
        if metadata.encoding == "ends":
            head = _checked_head(path, session, metadata, inputs)
    if _identity(path) != identity:
        raise ModelError(f"{path}: wanted an ONNX model, got one that changed while it was loaded")
    parallel = count != 1
    return LoadedModel(
        identity, threads, parallel, session, metadata, inputs, outputs, head, os.getpid()
    )


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


def _shapes(m: ModelMetadata) -> tuple[Shapes, Shapes]:
    """Of inputs and outputs by the metadata."""
    size = m.input_size
    if m.encoding == "unseen":
        return {"input": (1, len(UNSEEN), size, size)}, {OUTPUT: (1, ANSWERS_UNSEEN, size, size)}
    if m.encoding == "gaussian":
        return {"input": (1, 3, size, size)}, {OUTPUT: (1, 1, m.blocks, m.blocks)}
    side = size // _UNSHUFFLE
    places = size // QUERY_SPACING
    inputs = {
        "map": (1, 2 * _UNSHUFFLE**2, side, side),
        "query": (1, ENDS_CHANNELS, places, places),
        ASK: (1,),
    }
    in_parts = {PLACES: (1, 2 * m.head[0], places, places), HEAD: (count_parameters(m.head),)}
    return inputs, {OUTPUT: (1, ANSWERS, places, places), **in_parts}


def _checked_head(
    path: Path, session: "InferenceSession", m: ModelMetadata, inputs: Shapes
) -> Planes:
    """The parameters of the head; ModelError where they do not answer what the graph does."""
    seen = np.random.default_rng(0).random(inputs["map"], np.float32)
    side = m.input_size // QUERY_SPACING
    far = float(m.input_size - 1)
    asked = ((0.3 * far, 0.0), (far, 0.6 * far), m.sigma * m.input_size)
    query = np.zeros(inputs["query"], np.float32)
    answer = np.empty((m.blocks, m.blocks), np.float32)
    # a head without parameters encodes the query: compiled code that plans need is read, and no
    # other
    nothing = np.zeros(count_parameters(m.head), np.float32)
    PlaceHead(nothing, m.head, side).answer(*asked, query[0], answer)
    given = {"map": seen, "query": query, ASK: np.ones(1, np.bool_)}
    with refused_as(ModelError, f"{path}: wanted an ONNX model, got one whose graph fails"):
        wanted, places, found = session.run([OUTPUT, PLACES, HEAD], given)
    parameters = np.array(found, np.float32)
    head = PlaceHead(parameters, m.head, side)
    head.describe(places)
    head.answer(*asked, query[0], answer)
    in_place = wanted.reshape(2, 2, side, side).transpose(2, 0, 3, 1).reshape(answer.shape)
    if not np.abs(answer - in_place).max() <= _ROUNDING:
        raise ModelError(f"{path}: the head's parameters are not those of its graph")
    return parameters


def _after_fork() -> None:
    """In the child: open every file anew. Sessions of the parent are never freed here, as ending
    their threads would hang.
    """
    for loaded in set(_open.values()):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(loaded))
    _open.clear()
    _kept.clear()
    _loading.release()


os.register_at_fork(
    before=_loading.acquire, after_in_parent=_loading.release, after_in_child=_after_fork
)
