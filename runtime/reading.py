"""Files that a user names, read with care: regular files alone, with a limit, every failure in a
few words.
"""

import errno
import json
import os
import stat
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from nnpp_edge.runtime.errors import NnppEdgeError

MOST_BYTES = 1 << 24
"""Of a file of settings or figures; the longest of ours take a hundredth of it."""
_MOST_CHARACTERS = 400
"""Of a reason; some libraries quote all that they have read."""


def problem_with_file(path: Path | str | int) -> str | None:
    """Why no file can be read there (a path, or an open descriptor), in a few words; None for a
    regular file.
    """
    try:
        mode = os.stat(path).st_mode  # noqa: PTH116  # of a descriptor, too
    except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
        return reason(error)
    return (
        None if stat.S_ISREG(mode) else "a folder" if stat.S_ISDIR(mode) else "not a regular file"
    )


def reason(error: BaseException) -> str:
    """The cause of an error, in one line."""
    if isinstance(error, FileNotFoundError):
        return "no such file"
    if isinstance(error, MemoryError):
        return "not enough memory"
    words = (error.strerror if isinstance(error, OSError) else None) or str(error)
    line = " ".join(words.split()) or type(error).__name__
    return line if len(line) <= _MOST_CHARACTERS else f"{line[:_MOST_CHARACTERS]}…"


@contextmanager
def refused_as(kind: type[NnppEdgeError], what: str) -> Iterator[None]:
    """Turn whatever a broken file or a full disk raises into one `kind` that ends with the first
    cause.
    """
    try:
        yield
    except NnppEdgeError:
        raise
    except Exception as error:  # libraries meet bad bytes with nearly every kind there is
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        raise kind(f"{what} ({reason(cause)})") from error


def read_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """A regular file's UTF-8 text of at most so many bytes; OSError or ValueError for anything
    else.
    """
    # O_NONBLOCK: a pipe without a writer would be waited for
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        if (problem := problem_with_file(file.fileno())) is not None:
            raise OSError(errno.EINVAL, problem)
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"longer than {most_bytes} bytes")
    return content.decode("utf-8")


def read_toml(
    name: str | Path, shipped: Path, what: str, kind: type[NnppEdgeError]
) -> tuple[Path, dict[str, object]]:
    """The TOML file NAME in the folder `shipped`, else the user's file of that name, and its
    content.

    NnppEdgeError of this `kind`, about a file of `what`, where there is none, or none in TOML.
    """
    names = sorted(path.stem for path in shipped.glob("*.toml"))
    path = shipped / f"{name}.toml" if name in names else Path(name)
    if (problem := problem_with_file(path)) is not None:
        wanted = f"wanted a {what}'s file or the name of a shipped one ({', '.join(names)})"
        raise kind(f"{wanted}, got {str(name)!r} ({problem})")
    with refused_as(kind, f"{path}: wanted a {what} in TOML"):
        return path, parse(read_text(path), tomllib.loads)


def parse(text: str, loads: Callable[[str], Any] = json.loads) -> Any:
    """Content of JSON, or another format by its own function; ValueError where it is broken or
    nested too deep.
    """
    try:
        return loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None
