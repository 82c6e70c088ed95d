"""The one way in which this project compiles a kernel, and where the compiled kernels are kept.

numba writes its cache beside the source, and where that folder is read-only it raises at import. So a
folder is chosen here: NUMBA_CACHE_DIR if the user set it, else the user's own cache folder. A cache file
is a pickle, and whoever can write one can run code as us: a folder that another user owns or may write
to is refused. Without a folder, kernels are compiled anew in every process, with one warning.

A compiled kernel holds the code of those that it calls. So the folder's name carries a digest of the sources of all
kernels: changed code never meets an old cache. `cache` reads and writes the files.
"""

import hashlib
import os
import warnings
from contextlib import suppress
from pathlib import Path
from types import FunctionType

import numba
from numba.core.types import unliteral

from nnpp_edge import __version__
from nnpp_edge.runtime.compiled.cache import KernelCache, NumbaObject, make_private


def _source_digest() -> str:
    """Eight hex digits over every source file that a kernel's code comes from."""
    digest, runtime = hashlib.sha256(), Path(__file__).parent.parent
    for source in (*sorted((runtime / "kernels").glob("*.py")), Path(__file__)):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:8]


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
    for base in candidates:
        with suppress(OSError):
            make_private(base)
            make_private(base / name)
            return base / name
    return None


CACHE_FOLDER = cache_folder()
if CACHE_FOLDER is None:
    warnings.warn(
        "no folder that only this user can write to was found for compiled kernels: every process compiles "
        "them anew (set NUMBA_CACHE_DIR to such a folder)",
        RuntimeWarning,
        stacklevel=2,
    )


def kernel(function: FunctionType) -> NumbaObject:
    """Compile `function` without the GIL, cached in our folder; `function.py_func` is the plain Python.

    Work is shared between cores by threads that call kernels, not by numba's own parallel loops: those
    may not be entered from two threads at once, nor after a fork. A division by zero gives what the processor
    gives: to look for it would keep the compiler from computing several cells at once.
    """
    compiled = helper(function)
    if CACHE_FOLDER is not None and compiled is not function:  # as it is under NUMBA_DISABLE_JIT
        compiled._cache = KernelCache(function, CACHE_FOLDER)
    return compiled


def helper(function: FunctionType) -> NumbaObject:
    """As `kernel`, for one that only kernels call: their files hold its code, and none of its own keeps it."""
    compile_it: NumbaObject = numba.njit
    compiled = compile_it(nogil=True, error_model="numpy", no_cfunc_wrapper=True)(function)
    if compiled is not function:
        template = compiled.get_call_template

        def of_types(args: tuple[NumbaObject, ...], named: dict[str, NumbaObject]) -> NumbaObject:
            """Without literals: numba would compile a version for every constant in a call."""
            return template(tuple(map(unliteral, args)), {name: unliteral(kind) for name, kind in named.items()})

        compiled.get_call_template = of_types
    return compiled
