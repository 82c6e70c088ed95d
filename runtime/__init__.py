"""The robot's own part: cost map, network, search, loop. Needs numpy, numba, onnxruntime and
nothing of training.

Everything for users can be imported from here: the names in `__init__.pyi`, which type checkers
read too. A name is loaded when it is first used, so that a command which needs none of them starts
at once.
"""

import re
from importlib import import_module
from pathlib import Path

_LINES = re.findall(
    r"^from (\S+) import (\w+) as \2$", Path(__file__).with_suffix(".pyi").read_text(), re.MULTILINE
)
_MODULE_OF = {name: module for module, name in _LINES}


def __getattr__(name: str) -> object:
    if name == "World":  # for one release
        name = "Ground"
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted(_MODULE_OF)
