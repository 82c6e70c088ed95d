"""Files that a user names, read with care: regular files alone, with a limit, every failure in a
few words. Tables of settings that are read from them.
"""

import errno
import json
import os
import re
import stat
import tomllib
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, TypeVar, get_args

import msgspec
from msgspec.structs import asdict, fields

from nnpp_edge.runtime.errors import InvalidQueryError, NnppEdgeError

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


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A table of settings. msgspec checks types when it is read, `__post_init__` the rest."""

    hidden: ClassVar[str] = ""
    """Name of a field that is no key."""

    def refuse_unless(self, fits: bool, key: str, wanted: str) -> None:
        """ValueError about a key's value."""
        if not fits:
            raise ValueError(f"{key}: wanted {wanted}, got {getattr(self, key)!r}")

    def check_choice(self, key: str, choices: Collection[str | int]) -> None:
        """Refuse a value that is none of these."""
        wanted = f"one of {', '.join(map(str, choices))}"
        self.refuse_unless(getattr(self, key) in choices, key, wanted)

    def check_different(self, *keys: str) -> None:
        """Refuse lists that hold a value twice."""
        for key in keys:
            values = getattr(self, key)
            self.refuse_unless(len(set(values)) == len(values), key, "different values")


T = TypeVar("T")
TableT = TypeVar("TableT", bound=Table)


def converted(content: Any, kind: type[T]) -> T:
    """A table or another record of this content; InvalidQueryError names the key, what was wanted
    and what came.
    """
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        problem, _, place = str(error).replace("`", "").partition(" - at $")
        value = content
        for key in re.findall(r"\w+", place):
            value = value[int(key) if isinstance(value, list | tuple) else key]
        between = ": "
        if problem.startswith("Expected"):
            problem = f"{problem.partition(', got')[0]}, got {value!r}"
        elif problem.startswith("Object contains unknown"):
            problem += f": wanted one of {', '.join(_keys(kind, place))}"
        elif not problem.startswith("Object"):
            between = "."  # ours begin with the key
        raise InvalidQueryError(f"{place[1:]}{between}{problem}" if place else problem) from None


def changed(table: TableT, **changes: object) -> TableT:
    """A table as options on the command line ask for; None changes nothing. InvalidQueryError
    if out of range.
    """
    given = {key: value for key, value in changes.items() if value is not None}
    return converted(asdict(table) | given, type(table))


def _keys(kind: type, place: str) -> list[str]:
    """The keys of the table at that place, ``.device`` or ``.budgets[0]``, of a table."""
    tables = {each.encode_name: each.type for each in fields(kind)}
    inner = tables.get(place.strip(".[]0123456789"), kind)
    table = next(iter(get_args(inner)), inner)  # of a list's tables, their kind
    return [each.encode_name for each in fields(table) if each.name != table.hidden]
