"""Where compiled kernels are found, and the level of processor that they are compiled for.

The wheel nnpp-edge-kernels lies beside this package and is read first, then our own caches in
folders that cannot be written, as in a read-only image, then the cache that new kernels are written
to: NUMBA_CACHE_DIR if the user set it, else in the user's own cache folder. A file is a pickle, and
whoever can write one can run code as us: only those are read that nobody can have written but us,
or who wrote this package's own code. Without a folder to write to, kernels are compiled anew in
every process, with one warning.

A compiled kernel holds the code of those that it calls. So a folder's name carries a digest of the
sources of all kernels: changed code never meets an old cache.

Kernels are compiled for what all cores have in common, not for the core that happens to answer: so
a wheel holds what many machines need, and a board that switches cores off finds its kernels again.
The user's own NUMBA_CPU_NAME wins.
"""

import hashlib
import os
import platform
import stat
import sys
import warnings
from contextlib import suppress
from pathlib import Path

import numba

from nnpp_edge import __file__ as _package
from nnpp_edge import __version__

_V3 = "avx avx2 bmi1 bmi2 f16c fma abm movbe xsave"
_X86 = {"x86-64-v4": f"{_V3} avx512f avx512bw avx512cd avx512dq avx512vl", "x86-64-v3": _V3}
"""LLVM's names of processors that kernels are compiled for, the best first, and the flags which
their cores have.
"""
FEATURES = {"x86-64-v4": "-prefer-256-bit"}
"""Features by level that LLVM is told beside its name. Kernels compute runs of 32 cells: with
registers of 256 bits, as it would choose, the cost map takes 1.7 times as long."""
_OTHERS_MAY_WRITE = stat.S_IWGRP | stat.S_IWOTH
_CODE = Path(_package).stat()


def level_of(machine: str, cpuinfo: str) -> str | None:
    """The best level that each core in this text of /proc/cpuinfo has; None below the least."""
    if machine == "aarch64":
        # what every armv8-a has: an emulator shows the flags of another machine there
        return "cortex-a72"
    cores = [set(line.split()) for line in cpuinfo.splitlines() if line.startswith("flags")]
    common = set.intersection(*cores) if machine == "x86_64" and cores else set()
    return next((name for name, flags in _X86.items() if set(flags.split()) <= common), None)


def is_private(info: os.stat_result) -> bool:
    """Whether nobody but us can have written it."""
    return info.st_uid == os.geteuid() and not info.st_mode & _OTHERS_MAY_WRITE


def is_trusted(info: os.stat_result) -> bool:
    """Whether nobody can have written it but us, or who can have written this package's
    own code.
    """
    of_code = (info.st_uid, info.st_gid) == (_CODE.st_uid, _CODE.st_gid)
    return is_private(info) or (of_code and not info.st_mode & _OTHERS_MAY_WRITE & ~_CODE.st_mode)


def make_private(folder: Path) -> None:
    """Make `folder` and its parents if need be; OSError unless it is ours alone to write."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not is_private(folder.stat()) or not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(
            f"{folder}: wanted a folder that this user, and no other, can write to"
        )


def source_digest() -> str:
    """Eight hex digits over every source file that a kernel's code comes from."""
    digest = hashlib.sha256()
    runtime = Path(__file__).parent.parent
    kernels = sorted((runtime / "kernels").glob("*.py"))
    for source in (*kernels, Path(__file__).with_name("kernel.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:8]


def name_in_wheel(level: str) -> str:
    """The folder of nnpp-edge-kernels with what this package, Python and numba need on processors
    of a level.
    """
    python = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    return f"{__version__}-{_DIGEST}-{python}-numba{numba.__version__}-{level}"


def own_folders() -> tuple[Path | None, list[Path]]:
    """Our cache that can be written, the first that serves, and those before it that can only be
    read.
    """
    folders = {
        "XDG_CACHE_HOME": "nnpp-edge",
        "HOME": ".cache/nnpp-edge",
        "TMPDIR": f"nnpp-edge-{os.geteuid()}",
    }
    given = {"TMPDIR": "/tmp"} | os.environ
    candidates = [Path(given[name]) / folder for name, folder in folders.items() if given.get(name)]
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        candidates = [Path(chosen)]
    only_read: list[Path] = []
    for base in candidates:
        folder = base / f"kernels-{__version__}-{_DIGEST}"
        with suppress(OSError):
            make_private(base)
            make_private(folder)
            return folder, only_read
        with suppress(OSError):
            if is_trusted(base.stat()) and is_trusted(folder.stat()):
                only_read.append(folder)
    return None, only_read


def in_wheel(level: str, wheel: Path) -> list[Path]:
    """The folder of the wheel that serves here; with a word where the wheel is there and
    has none.
    """
    if not wheel.is_dir():
        return []
    folder = wheel / name_in_wheel(level)
    if not folder.is_dir():
        there = ", ".join(sorted(each.name for each in wheel.iterdir()))
        problem = f"wanted {folder.name}, got {there or 'nothing'}"
    elif not (is_trusted(wheel.stat()) and is_trusted(folder.stat())):
        problem = f"{folder} can be written by others than the owner of {_package}"
    else:
        return [folder]
    pass_over_wheel(problem)
    return []


passed_over = False


def pass_over_wheel(problem: str) -> None:
    """Warn once that kernels are compiled in place of those of the wheel."""
    global passed_over
    if not passed_over:
        text = f"nnpp-edge-kernels is passed over, kernels are compiled here: {problem}"
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    passed_over = True


if not {"NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"} & os.environ.keys():  # else the user has chosen
    with suppress(OSError):
        if _level := level_of(platform.machine(), Path("/proc/cpuinfo").read_text()):
            os.environ.update(NUMBA_CPU_NAME=_level, NUMBA_CPU_FEATURES=FEATURES.get(_level, ""))
            numba.config.reload_config()
_DIGEST = source_digest()
WHEEL = in_wheel(
    os.environ.get("NUMBA_CPU_NAME", "this processor"),
    Path(_package).parents[1] / "nnpp_edge_kernels",
)
OWN, _only_read = own_folders()
READ = (*WHEEL, *_only_read)
if OWN is None and not READ:
    warnings.warn(
        "no folder that only this user can write to was found for compiled kernels: every process "
        "compiles them anew (set NUMBA_CACHE_DIR to such a folder)",
        RuntimeWarning,
        stacklevel=2,
    )
