"""Model files that this process has opened: each is loaded and checked once, for all networks that share it.

A session that no network uses any more is kept while it is one of the `KEPT` that were asked for last: calls of
`plan_path`, one after another, then load a file once, and a process that opens many files does not grow.
"""

import ctypes
import os
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import ModelError, NnppEdgeError
from nnpp_edge.runtime.network.encoding import ENDS_CHANNELS
from nnpp_edge.runtime.network.model_file import (
    ModelMetadata,
    model_errors,
    model_path,
    open_session,
    read_metadata,
)
from nnpp_edge.runtime.network.place_head import ANSWERS, PlaceHead, count_parameters
from nnpp_edge.runtime.tuning import TWO_THREADS_FROM

if TYPE_CHECKING:
    from onnxruntime import InferenceSession, SessionOptions

OUTPUT, PLACES, HEAD = "probability", "places", "head"
"""Names of the outputs; the last two are those of networks in two parts (`place_head`)."""
ASK = "ask"
"""Name of their input that says whether the head is to run, too."""
QUERY_SPACING = 8
"""Network cells between the points of an encoded query."""
DEFAULT_THREADS = 2
KEPT = 2
"""Sessions kept without a network that uses them."""
_ROUNDING = 1e-4
"""How far the head's answer may lie from its graph's, which adds in another order."""
Shapes = dict[str, tuple[int, ...]]


class FileIdentity(NamedTuple):
    """What tells a file from any other, and from what it was before it was written to."""

    device: int
    inode: int
    size: int
    modified_ns: int
    changed_ns: int
    """It cannot be set back, as `modified_ns` can."""

    @classmethod
    def of(cls, path: Path) -> "FileIdentity":
        """That of the file as it is now; ModelError if there is none."""
        try:
            found = path.stat()
        except OSError as error:
            raise ModelError(f"{path}: wanted a file to read, got: {error.strerror}") from error
        return cls(found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)


@dataclass(eq=False)
class LoadedModel:
    """What networks that share a session have in common."""

    identity: FileIdentity
    session: "InferenceSession"
    metadata: ModelMetadata
    inputs: Shapes
    outputs: Shapes
    threads: int
    spinning: bool
    head_parameters: NDArray[np.float32] | None
    """Of a network in two parts."""
    process: int
    """That opened it."""
    fastest_s: float = 0.0
    """What the session's fastest run took, or less; 0 before the first."""

    def lacks_threads(self) -> bool:
        """Whether its session waits for threads that another process has, from which this one was forked."""
        return self.threads > 1 and self.process != os.getpid()


class _Key(NamedTuple):
    """What was asked for. Without a number of threads, that depends on the cores."""

    identity: FileIdentity
    threads: int | None
    spinning: bool
    cores: int


_loading = threading.RLock()
"""Held by the thread that loads a file, and by one that forks: no child begins with a file half loaded."""
_open: WeakValueDictionary[_Key, LoadedModel] = WeakValueDictionary()
_kept: deque[LoadedModel] = deque(maxlen=KEPT)


def opened(path: Path, threads: int | None = None, spinning: bool = False) -> tuple[LoadedModel, bool]:
    """A model file's session, and whether it had to be waited for; it is opened if this process has not yet.

    Parameters
    ----------
    path, threads, spinning
        As for `NetworkModel`.

    Raises
    ------
    ModelError
        As for `NetworkModel`: whoever asks for a file that cannot be loaded tries again, and is told.
    """
    key = _key(path, threads, spinning)
    loaded = _open.get(key)
    if waited := loaded is None:
        with _loading:
            loaded = _open.get(key)
            if loaded is None:
                _open[key] = loaded = _load(path, key)
    if not _kept or _kept[-1] is not loaded:
        _kept.append(loaded)
    return loaded, waited


def begin_loading(model: object, threads: int | None = None, spinning: bool = False) -> None:
    """Open the file of a model, by its name or path, in the background. Whoever asks for it meanwhile waits for it.

    Nothing is done for a model that is loaded already. Errors are left to those who ask.
    """
    if not isinstance(model, str | Path):
        return
    with suppress(NnppEdgeError, RuntimeError):  # the latter where no thread can be started
        path = model_path(model)
        if _key(path, threads, spinning) not in _open:
            # no daemon: a process that ends in the middle of an import of onnxruntime may crash
            threading.Thread(target=_try_to_open, args=(path, threads, spinning), name="load a model").start()


def _try_to_open(path: Path, threads: int | None, spinning: bool) -> None:
    with suppress(Exception):
        opened(path, threads, spinning)


def _key(path: Path, threads: int | None, spinning: bool) -> _Key:
    cores = min(DEFAULT_THREADS, len(os.sched_getaffinity(0))) if threads is None else 0
    return _Key(FileIdentity.of(path), threads, spinning, cores)


def _load(path: Path, key: _Key) -> LoadedModel:
    """Read, check and open a file, unless it is open with the number of threads that `key` stands for."""
    metadata = read_metadata(path)
    threads = key.threads
    if threads is None:
        threads = 1 if metadata.input_size < TWO_THREADS_FROM else key.cores
    settled = key._replace(threads=threads, cores=0)
    if (found := _open.get(settled)) is not None:
        return found
    session = open_session(path, _options(threads, key.spinning))
    with model_errors(path, "got one that does not fit its metadata"):
        inputs, outputs = _checked_shapes(path, session, metadata)
        head = _checked_head(path, session, metadata, inputs) if metadata.encoding == "ends" else None
    if FileIdentity.of(path) != key.identity:
        raise ModelError(f"{path}: wanted an ONNX model, got one that changed while it was loaded")
    facts = inputs, outputs, threads, key.spinning, head, os.getpid()
    _open[settled] = loaded = LoadedModel(key.identity, session, metadata, *facts)
    return loaded


def _options(threads: int, spinning: bool) -> "SessionOptions":
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = True
    options.add_session_config_entry("session.intra_op.allow_spinning", "1" if spinning else "0")
    return options


def _checked_shapes(path: Path, session: "InferenceSession", m: ModelMetadata) -> tuple[Shapes, Shapes]:
    """Shapes of inputs and outputs by the metadata; ModelError where the graph has others."""
    size, places = m.input_size, m.input_size // QUERY_SPACING
    inputs: Shapes = {"input": (1, 3, size, size)}
    if m.encoding != "gaussian":
        side = size // m.map_unshuffle
        inputs = {"map": (1, 2 * m.map_unshuffle**2, side, side), "query": (1, ENDS_CHANNELS, places, places)}
    side = m.blocks // m.output_shuffle
    outputs: Shapes = {OUTPUT: (1, m.output_shuffle**2, side, side)}
    if m.encoding == "ends":
        inputs[ASK] = (1,)
        outputs |= {PLACES: (1, 2 * m.head[0], places, places), HEAD: (count_parameters(m.head),)}
    got = {i.name: tuple(i.shape) for i in session.get_inputs()}
    if got != inputs:
        raise ModelError(f"{path}: wanted inputs {inputs} by its metadata, got {got}")
    if m.encoding == "ends" and (m.output_shuffle**2 != ANSWERS or side != places):
        raise ModelError(
            f"{path}: wanted two by two blocks to each of {places} × {places} places, "
            f"got {m.blocks} to a side, {m.output_shuffle} by {m.output_shuffle}"
        )
    got = {o.name: tuple(o.shape) for o in session.get_outputs()}
    if got != outputs:
        raise ModelError(f"{path}: wanted outputs {outputs} by its metadata, got {got}")
    return inputs, outputs


def _checked_head(path: Path, session: "InferenceSession", m: ModelMetadata, inputs: Shapes) -> NDArray[np.float32]:
    """The parameters of the head; ModelError where they do not answer what the graph does."""
    seen = np.random.default_rng(0).random(inputs["map"], np.float32)
    side, far, sigma = m.input_size // QUERY_SPACING, float(m.input_size - 1), m.sigma * m.input_size
    ends = (0.3 * far, 0.0), (far, 0.6 * far), float(QUERY_SPACING), sigma
    query = np.zeros(inputs["query"], np.float32)
    answer = np.empty((m.blocks, m.blocks), np.float32)
    # a head without parameters encodes the query: compiled code that plans need is read, and no other
    PlaceHead(np.zeros(count_parameters(m.head), np.float32), m.head, side).answer_ends(*ends, query[0], answer)
    with model_errors(path, "got one whose graph fails"):
        found = session.run([OUTPUT, PLACES, HEAD], {"map": seen, "query": query, ASK: np.ones(1, np.bool_)})
    wanted, places, parameters = found
    head = PlaceHead(parameters, m.head, side)
    head.places[:] = places_in_rows(places)
    head.answer_ends(*ends, query[0], answer)
    if not np.abs(answer - blocks_in_place(wanted, m)).max() <= _ROUNDING:
        raise ModelError(f"{path}: the head's parameters are not those of its graph")
    return np.array(parameters, np.float32)


def places_in_rows(places: NDArray[np.float32]) -> NDArray[np.float32]:
    """The encoder's output, (1, 2R, P, P), as `PlaceHead.places` are: (P², 2R)."""
    return places.reshape(places.shape[1], -1).T


def blocks_in_place(output: NDArray[np.float32], metadata: ModelMetadata) -> Float2D:
    """The graph's answer, (1, n², B / n, B / n), with each block where it lies: (B, B)."""
    n, blocks = metadata.output_shuffle, metadata.blocks
    side = blocks // n
    return output.reshape(n, n, side, side).transpose(2, 0, 3, 1).reshape(blocks, blocks)


def _after_fork() -> None:
    """In the child: open every file anew. Sessions of the parent live on, for to end their threads would hang."""
    for loaded in set(_open.values()):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(loaded))
    _open.clear()
    _kept.clear()
    _loading.release()


os.register_at_fork(before=_loading.acquire, after_in_parent=_loading.release, after_in_child=_after_fork)
