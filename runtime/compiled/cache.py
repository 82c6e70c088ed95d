"""Compiled kernels on disk: a file for each version of a kernel, so that no process can spoil
another's.

numba's own cache has an index for each kernel that is read, changed and written. Two processes at
once can lose an entry, or leave one that leads to machine code for other types or for another
processor; a process killed between index and code can do the same. A damaged file raises in the
middle of a plan.

Here a version (the types of the arguments, the processor, Python's and numba's versions) has a file
of its own, named after all these and put in its place whole, by renaming. Nothing is shared and
nothing is locked, but by processes that fill a folder together (`claims`): they may be forked or
killed at any moment. A checksum comes first, since a robot that loses its power may be left with a
file of zeros. What cannot be read back is compiled anew and written again; what cannot be written
is warned of once, and the kernel runs all the same. `places` says where files are.
"""

import errno
import hashlib
import os
import pickle
import secrets
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Timer
from types import FrameType, FunctionType
from typing import Any

import numba
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from nnpp_edge.runtime.compiled import places
from nnpp_edge.runtime.stopwatch import preparing

NumbaObject = Any
"""Something of numba's own, which has no types."""
_COMPILING = (
    "compiling for this processor: up to a minute, minutes on a small board, once (nnpp-edge "
    "warmup does it ahead of time; the package nnpp-edge-kernels brings what it compiles)"
)
_compiling: list[Timer] = []
"""Of the kernels that are being compiled, each within another."""
_CHECKSUM_BYTES = 32
save_error: OSError | None = None
"""Why the first of the kernels that this process could not keep was not kept; None if all were."""


class KernelCache(NullCache):
    """The store that numba asks for the compiled versions of `function`, and hands new ones to.

    Parameters
    ----------
    function : function of a module
        The plain Python of the kernel.
    folder : Path or None
        Where files are written. It belongs to one state of the sources: whoever changes a kernel,
        or one that it calls, changes the folder. It and the folder it lies in are made again if
        they vanish.
    read : paths
        Folders that are only read, and before `folder`.

    Raises
    ------
    ValueError
        `function` closes over variables, which the name of a file would have to tell apart.
    """

    def __init__(
        self, function: FunctionType, folder: Path | None, read: Sequence[Path] = ()
    ) -> None:
        code = function.__code__
        if code.co_freevars:
            raise ValueError(
                f"wanted a kernel without outer variables, got {function.__qualname__} with "
                f"{code.co_freevars}"
            )
        self._folder = folder
        self._read = [*read, *([folder] if folder else [])]
        self._stem = f"{function.__module__}.{function.__qualname__}-{code.co_firstlineno}"
        self._made_by = (
            code.co_code,
            code.co_consts,
            numba.__version__,
            *sys.version_info[:2],
            sys.abiflags,
        )

    def load_overload(self, sig: NumbaObject, target_context: NumbaObject) -> NumbaObject:
        """The compiled version for `sig`, or None where no sound one is kept: `save_overload`
        follows then.
        """
        preparing.begins()
        target_context.refresh()
        key = self._key(sig, target_context.codegen())
        from nnpp_edge.runtime.compiled import claims, notice

        claims.take(_digest(key))
        kept = self._find(key, target_context)
        if kept is not None:
            claims.release(_digest(key))
            preparing.ends()
            return kept
        _compiling.append(notice.begins(_COMPILING))
        _let_interrupts_come()
        return None

    def _find(self, key: bytes, target_context: NumbaObject) -> NumbaObject:
        for folder in self._read:
            path = folder / self._name(key)
            kept = self._load(path, key, target_context)
            if kept is not None:
                return kept
            if folder in places.WHEEL:
                damaged = "damaged, or not its owner alone can write it"
                places.pass_over_wheel(f"{path} is {damaged if path.exists() else 'missing'}")
        return None

    def _load(self, path: Path, key: bytes, target_context: NumbaObject) -> NumbaObject:
        try:
            with path.open("rb") as file:
                if not places.is_trusted(os.fstat(file.fileno())):
                    return None
                content = file.read()
            kept = content[_CHECKSUM_BYTES:]
            if content[:_CHECKSUM_BYTES] != _checksum(key, kept):
                return None
            return CompileResult._rebuild(target_context, *pickle.loads(kept))
        except Exception:
            # it cannot be read, or was made by something that differs from us in a way which the
            # key does not tell
            return None

    def save_overload(self, sig: NumbaObject, data: NumbaObject) -> None:
        """Keep the compiled version `data` for `sig`, unless it holds addresses of this process."""
        from nnpp_edge.runtime.compiled import claims

        _compiling.pop().cancel()
        key = self._key(sig, data.codegen)
        if not (data.lifted or data.library.has_dynamic_globals):
            self._save(key, data)
        claims.release(_digest(key))
        preparing.ends()

    def _save(self, key: bytes, data: NumbaObject) -> None:
        content = dumps(data._reduce())
        try:
            if self._folder is None:
                raise OSError(errno.EROFS, "no folder to write to")
            for folder in (self._folder.parent, self._folder):
                places.make_private(folder)
            _write(self._folder / self._name(key), _checksum(key, content) + content)
        except OSError as error:
            _tell_once(self._folder, error)

    def _key(self, sig: NumbaObject, codegen: NumbaObject) -> bytes:
        """All that a compiled version depends on."""
        return repr((self._stem, self._made_by, repr(sig), codegen.magic_tuple())).encode()

    def _name(self, key: bytes) -> str:
        return f"{self._stem}.{_digest(key)}.nbc"


def count_kept(*folders: Path) -> tuple[int, int]:
    """How many kernels are kept in these folders, and how many versions of them in all."""
    names = {path.name for folder in folders for path in folder.glob("*.nbc")}
    return len({name.rsplit(".", 2)[0] for name in names}), len(names)


def _tell_once(folder: Path | None, error: OSError) -> None:
    """Warn of the first failure; numba's compiler lock keeps other threads out."""
    global save_error
    if save_error is not None:
        return
    save_error = error.with_traceback(None)
    where = (
        f"in {folder} ({error.strerror or error})"
        if folder
        else "(set NUMBA_CACHE_DIR to a folder of this user's)"
    )
    warnings.warn(
        f"compiled kernels cannot be kept {where}: other processes compile them again",
        RuntimeWarning,
        stacklevel=2,
    )


def _digest(key: bytes) -> str:
    return hashlib.sha256(key).hexdigest()[:16]


def _checksum(key: bytes, content: bytes) -> bytes:
    """Of the key as well, so that a file under a wrong name is not taken for sound."""
    return hashlib.sha256(key + content).digest()


def _write(path: Path, content: bytes) -> None:
    """Put `content` at `path` in one step, for us alone to write."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        temporary.touch(mode=0o600, exist_ok=False)
        temporary.write_bytes(content)
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise


_let_come: list[Callable[[], None]] = []
"""While SIGINT waits, what ends that."""


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Within, SIGINT waits for the end, or for a compilation, which takes long.

    numba's tables would else be left with half of what belongs together, and a later call fail.
    """
    handler = signal.getsignal(signal.SIGINT)
    # only the main thread is interrupted; a handler that Python does not know cannot be put back
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or _let_come or not callable(handler):
        yield
        return
    came: list[FrameType | None] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append(frame))

    def let_come() -> None:
        signal.signal(signal.SIGINT, handler)
        if came:
            handler(signal.SIGINT, came[0])

    _let_come.append(let_come)
    try:
        yield
    finally:
        _let_interrupts_come()


def _let_interrupts_come() -> None:
    if threading.current_thread() is threading.main_thread() and _let_come:
        _let_come.pop()()
