"""Compile all kernels for every level of processor, and pack them as wheels of nnpp-edge-kernels.

python .ci/kernel_wheel.py FOLDER [KERNEL...]    in an environment with nnpp-edge; KERNEL: module:name, these alone

One x86-64 machine compiles for all: kernels are run once to see with which types they are called,
then a process for each level compiles them for these types with LLVM's target set, and runs none. A
wheel is for one Python and one numba: a compiled version is kept under a name that holds both.
"""

import base64
import hashlib
import importlib
import os
import pickle
import pkgutil
import subprocess
import sys
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

MACHINES = {"x86_64": ("x86-64-v3", "x86-64-v4"), "aarch64": ("cortex-a72",)}
TRIPLE = "aarch64-unknown-linux-gnu"


def note_types(listed: Path, *names: str) -> None:
    """Write down with which types each kernel that has a file of its own is called."""
    from nnpp_edge.runtime import kernels
    from nnpp_edge.runtime.compiled.cache import KernelCache
    from nnpp_edge.runtime.exercises import exercise

    exercise()
    found = {}
    for info in pkgutil.iter_modules(kernels.__path__, f"{kernels.__name__}."):
        for name, value in vars(importlib.import_module(info.name)).items():
            if (
                isinstance(getattr(value, "_cache", None), KernelCache)
                and value.py_func.__module__ == info.name
            ):
                found[f"{info.name}:{name}"] = sorted(value.signatures, key=str)
    listed.write_bytes(pickle.dumps({name: found[name] for name in names or found if found[name]}))


def compile_all(listed: Path, level: str) -> None:
    """Compile what was written down for the level that the environment names, into the cache that
    it names.
    """
    if level in MACHINES["aarch64"]:
        import llvmlite.binding as llvm

        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
        llvm.get_process_triple = lambda: TRIPLE
        llvm.Target.from_default_triple = classmethod(lambda target: target.from_triple(TRIPLE))
    from numba.core import ir
    from numba.core.annotations.type_annotations import TypeAnnotation
    from numba.np.ufunc import array_exprs

    import nnpp_edge.runtime.exercises  # noqa: F401 - all modules
    from nnpp_edge.runtime.compiled import cache, places

    # the same whatever the process and the folder: without a fifth of each file, which numba's
    # inspect_types alone reads, addresses in names, and paths of sources that errors name
    numbers = count()
    array_exprs.hex = lambda address: str(next(numbers))
    TypeAnnotation.__str__ = lambda annotation: ""
    begin = ir.Loc.__init__

    def begin_within_packages(loc: ir.Loc, filename: str, *rest: object, **named: object) -> None:
        begin(loc, filename.rpartition("site-packages/")[2], *rest, **named)

    ir.Loc.__init__ = begin_within_packages

    types = pickle.loads(listed.read_bytes())
    for name, signatures in types.items():
        module, _, kernel = name.partition(":")
        for signature in signatures:
            getattr(importlib.import_module(module), kernel).compile(signature)
    if cache.save_error:
        raise cache.save_error
    print(places.name_in_wheel(level), places.OWN)


def pack(folder: Path, machine: str, compiled: dict[str, Path]) -> Path:
    """Put a wheel into `folder`, with the files of each of these folders under the
    folder's name.
    """
    import numba

    from nnpp_edge import __version__

    python, info = (
        f"cp{sys.version_info[0]}{sys.version_info[1]}",
        f"nnpp_edge_kernels-{__version__}.dist-info",
    )
    tag = f"{python}-none-manylinux_2_17_{machine}.manylinux2014_{machine}"
    files = {
        f"nnpp_edge_kernels/{name}/{path.name}": path.read_bytes()
        for name, kept in compiled.items()
        for path in sorted(kept.glob("*.nbc"))
    }
    files[f"{info}/METADATA"] = (
        f"Metadata-Version: 2.4\nName: nnpp-edge-kernels\nVersion: {__version__}\n"
        f"Summary: Compiled kernels of nnpp-edge {__version__} for {', '.join(MACHINES[machine])}\n"
        "License-Expression: Apache-2.0\nLicense-File: LICENSE\nRequires-Python: "
        f"=={python[2]}.{python[3:]}.*\n"
        f"Requires-Dist: nnpp-edge=={__version__}\nRequires-Dist: numba=={numba.__version__}\n"
        "Description-Content-Type: text/plain\n\n"
        "Machine code that nnpp-edge would else compile at its first start. It is found by itself.\n"
    ).encode()
    tags = "".join(f"Tag: {python}-none-{each}\n" for each in tag.split("-")[2].split("."))
    files[f"{info}/WHEEL"] = (
        f"Wheel-Version: 1.0\nGenerator: kernel_wheel\nRoot-Is-Purelib: false\n{tags}".encode()
    )
    files[f"{info}/licenses/LICENSE"] = (Path(__file__).parent.parent / "LICENSE").read_bytes()
    lines = []
    for name, content in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        lines.append(f"{name},sha256={digest},{len(content)}\n")
    files[f"{info}/RECORD"] = "".join([*lines, f"{info}/RECORD,,\n"]).encode()
    made = folder / f"nnpp_edge_kernels-{__version__}-{tag}.whl"
    with ZipFile(made, "w", ZIP_DEFLATED) as wheel:
        for name, content in files.items():
            entry = ZipInfo(name)  # of 1980: the same files give the same wheel
            entry.external_attr = 0o644 << 16
            entry.compress_type = ZIP_DEFLATED
            wheel.writestr(entry, content)
    return made


def main(folder: Path, *names: str) -> None:
    from nnpp_edge.runtime.compiled.places import FEATURES

    with TemporaryDirectory() as work:

        def step(what: str, *words: str, **chosen: str) -> list[str]:
            """Do a part in a process of its own; the words that it prints."""
            command = [sys.executable, __file__, what, f"{work}/types", *words]
            ended = subprocess.run(
                command, env=os.environ | chosen, check=True, stdout=subprocess.PIPE, text=True
            )
            return ended.stdout.split()

        def compiled_for(level: str) -> tuple[str, Path]:
            """Name and place of the kernels for a level."""
            features, kept = FEATURES.get(level, ""), f"{work}/{level}"
            chosen = {
                "NUMBA_CPU_NAME": level,
                "NUMBA_CPU_FEATURES": features,
                "NUMBA_CACHE_DIR": kept,
                "PYTHONHASHSEED": "0",  # the order of sets is in the code: the same makes the same
            }
            name, folder = step("compile", level, **chosen)
            return name, Path(folder)

        # of all kernels in a cache of its own: what other Pythons compile is not left in the user's
        step("note", *names, **({} if names else {"NUMBA_CACHE_DIR": f"{work}/note"}))
        folder.mkdir(parents=True, exist_ok=True)
        for machine, levels in MACHINES.items():
            compiled = dict(map(compiled_for, levels))
            made = pack(folder, machine, compiled)
            counts = ", ".join(f"{len([*kept.iterdir()])} versions" for kept in compiled.values())
            print(f"{made}: {made.stat().st_size / 1e6:.1f} MB, {counts}")


if __name__ == "__main__":
    what, *words = sys.argv[1:]
    if what == "note":
        note_types(Path(words[0]), *words[1:])
    elif what == "compile":
        compile_all(Path(words[0]), words[1])
    else:
        main(Path(what), *words)
