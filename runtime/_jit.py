"""The one way in which this project compiles a kernel, and where the compiled kernels are kept.

numba writes its cache beside the source, and where that folder is read-only it raises at import. So a
folder is chosen here: NUMBA_CACHE_DIR if the user set it, else the user's own cache folder. A cache file
is a pickle, and whoever can write one can run code as us: a folder that another user owns or may write
to is refused. Without a folder, kernels are compiled anew in every process, with one warning.

numba sees that a kernel's own file has changed, not that a kernel which it calls has. So the folder's
name carries a digest of the runtime's sources: changed code never meets an old cache.
"""

import hashlib
import os
import stat
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from nnpp_edge import __version__


def _source_digest() -> str:
    """Eight hex digits over every source file of the runtime."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:8]


def _is_safe(folder: Path) -> bool:
    """Make `folder` if need be; tell whether it is ours alone to write."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        info = folder.stat()
    except OSError:
        return False
    ours = info.st_uid == os.geteuid() and not info.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return ours and os.access(folder, os.W_OK | os.X_OK)


def cache_folder() -> Path | None:
    """Folder for this version's compiled kernels, or None where no safe one can be written.

    The first that serves of NUMBA_CACHE_DIR (that alone, if set), $XDG_CACHE_HOME/nnpp-edge,
    ~/.cache/nnpp-edge, and a folder under the user's number in the system's temporary folder.
    """
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        candidates = [Path(chosen)]
    else:
        candidates = [Path(os.environ.get("TMPDIR", "/tmp")) / f"nnpp-edge-{os.geteuid()}"]
        if home := os.environ.get("HOME"):
            candidates.insert(0, Path(home) / ".cache" / "nnpp-edge")
        if xdg := os.environ.get("XDG_CACHE_HOME"):
            candidates.insert(0, Path(xdg) / "nnpp-edge")
    name = f"kernels-{__version__}-{_source_digest()}"
    return next((base / name for base in candidates if _is_safe(base) and _is_safe(base / name)), None)


CACHE_FOLDER = cache_folder()
if CACHE_FOLDER is None:
    warnings.warn(
        "no folder that only this user can write to was found for compiled kernels: every process compiles "
        "them anew (set NUMBA_CACHE_DIR to such a folder)",
        RuntimeWarning,
        stacklevel=2,
    )


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function` without the GIL, cached in our folder; `function.py_func` is the plain Python.

    Work is shared between cores by threads that call kernels, not by numba's own parallel loops: those
    may not be entered from two threads at once, nor after a fork.
    """
    if CACHE_FOLDER is None:
        return numba.njit(nogil=True)(function)
    config: Any = numba.config
    theirs = config.CACHE_DIR
    config.CACHE_DIR = str(CACHE_FOLDER)  # read when the dispatcher is made, so put back at once
    try:
        return numba.njit(cache=True, nogil=True)(function)
    finally:
        config.CACHE_DIR = theirs
