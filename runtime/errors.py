"""Errors of the toolkit, and the words that a planner answers with.

Every error derives from `NnppEdgeError` and from the builtin that fits. Its message is one line
that says what was wanted and what came. That no path exists is an outcome, not an error: see
`Status`.
"""

import sys
from enum import StrEnum
from importlib import import_module
from types import ModuleType

INSTALL = "pip install -e '.[{0}]' in a clone, or pip install 'FILE.whl[{0}]'"
"""How an extra is installed while no release is published; documents name these ways alone
(tests/test_documents.py).
"""


class NnppEdgeError(Exception):
    """Base of every error that the toolkit raises on purpose."""


class InvalidMapError(NnppEdgeError, ValueError):
    """An elevation or cost map that cannot be planned on."""


class InvalidQueryError(NnppEdgeError, ValueError):
    """A start, goal or option that makes no sense."""


class ConcurrentUseError(NnppEdgeError, RuntimeError):
    """A planner was called from a second thread while it was at work."""


class TerrainError(NnppEdgeError, ValueError):
    """A terrain file that cannot be read as a digital elevation model."""


class ModelError(NnppEdgeError, ValueError):
    """A model file that cannot be used: unreadable, or its metadata does not fit."""


class DataSetError(NnppEdgeError, ValueError):
    """A data set folder that cannot be used."""


class MissingExtraError(NnppEdgeError, ImportError):
    """An optional package is needed; the message names the extra that brings it."""


def users_line() -> int:
    """The `stacklevel` by which a warning names the line outside this package that led to it."""
    level = 1
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("nnpp_edge."):
        frame = frame.f_back
        level += 1
    return level


def optional_module(name: str, purpose: str, extra: str) -> ModuleType:
    """A module that an extra brings; a MissingExtraError says what needs it, and how to get it."""
    try:
        return import_module(name)
    except Exception as error:  # a package that does not fit another raises nearly every kind
        problem = import_problem(name.partition(".")[0], extra, error)
        raise MissingExtraError(f"{purpose} needs {problem}") from error


def import_problem(package: str, extra: str, error: Exception) -> str:
    """A package that could not be imported: how to get it, or why it fails although it is there."""
    if isinstance(error, ModuleNotFoundError) and error.name == package:
        return f"{package}: {INSTALL.format(extra)}"
    return f"{package}, which is installed but cannot be imported ({' '.join(str(error).split())})"


class OutputError(NnppEdgeError, OSError):
    """A result could not be written; what stood there before is untouched."""


class Status(StrEnum):
    """How a plan, or a tick of the onboard loop, ended, in the words of Nav2's planner server."""

    OK = "OK"
    START_OUTSIDE_MAP = "START_OUTSIDE_MAP"
    GOAL_OUTSIDE_MAP = "GOAL_OUTSIDE_MAP"
    START_BLOCKED = "START_BLOCKED"
    GOAL_BLOCKED = "GOAL_BLOCKED"
    NO_PATH = "NO_PATH"
    TIMEOUT = "TIMEOUT"
    INVALID_MAP = "INVALID_MAP"
    NO_POSE = "NO_POSE"
    """Of the loop alone: no pose has come yet."""
    NO_GOAL = "NO_GOAL"
    """Of the loop alone: no goal has come yet."""
    UNKNOWN = "UNKNOWN"
    """Of the loop: every way of planning raised an error."""


def shown(value: object) -> str:
    """A value for the end of a message: one line, and not a long one."""
    try:
        return " ".join(repr(value).split())[:80]
    except Exception:  # a whole number of 5,000 digits, say
        return f"a {type(value).__name__}"


def one_line(error: BaseException) -> str:
    """An error's type and message in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
