"""A table of a TOML file whose keys are read one by one and checked; what is left at the end is unknown."""

import math
from collections.abc import Mapping
from typing import TypeVar, cast

from nnpp_edge.runtime.errors import InvalidQueryError

ValueT = TypeVar("ValueT")
DefaultT = TypeVar("DefaultT")


class ProfileError(InvalidQueryError):
    """A profile that cannot be used; the message names the file and the key."""


class TomlTable:
    """Reads a table.

    Parameters
    ----------
    file : str
        The file's name, for messages.
    place : str
        Keys that lead to the table, joined by dots; empty for the whole file.
    content : mapping
        What the table holds.
    """

    def __init__(self, file: str, place: str, content: Mapping[str, object]) -> None:
        self.file, self.place, self.unread = file, place, dict(content)
        self._known: list[str] = []

    def error(self, key: str, wanted: str, got: object) -> ProfileError:
        """An error about a key's value."""
        return ProfileError(f"{self.file}: {self._name(key)}: wanted {wanted}, got {got!r}")

    def table(self, key: str) -> "TomlTable":
        """The table under a key, empty where it is missing."""
        content = self.optional(key, dict, "a table", cast(dict[str, object], {}))
        return TomlTable(self.file, self._name(key), content)

    def needed(self, key: str, kind: type[ValueT], wanted: str) -> ValueT:
        """The value of a key that must be there."""
        if key not in self.unread:
            raise ProfileError(f"{self.file}: {self._name(key)} is missing: wanted {wanted}")
        value = self.optional(key, kind, wanted, None)
        assert value is not None  # TOML has no null
        return value

    def optional(self, key: str, kind: type[ValueT], wanted: str, default: DefaultT) -> ValueT | DefaultT:
        """The value of a key, which must be of the type; the default where it is missing."""
        self._known.append(key)
        if key not in self.unread:
            return default
        value = self.unread.pop(key)
        if not _is(value, kind):
            raise self.error(key, wanted, value)
        return cast(ValueT, value)

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        """One of some words; without a default the key is needed."""
        wanted = f"one of {', '.join(choices)}"
        value = self.needed(key, str, wanted) if default is None else self.optional(key, str, wanted, default)
        if value not in choices:
            raise self.error(key, wanted, value)
        return value

    def several(self, key: str, kind: type[ValueT], wanted: str, default: tuple[ValueT, ...]) -> tuple[ValueT, ...]:
        """One value or a list of different ones."""
        value = self.optional(key, object, wanted, default)
        values = tuple(value) if isinstance(value, list | tuple) else (value,)
        if not values or not all(_is(each, kind) for each in values) or len(set(values)) < len(values):
            raise self.error(key, f"{wanted}, or a list of different ones", value)
        return cast(tuple[ValueT, ...], values)

    def finish(self) -> None:
        """Refuse keys that were not read."""
        for key in self.unread:
            raise ProfileError(f"{self.file}: {self._name(key)} is unknown: wanted one of {', '.join(self._known)}")

    def _name(self, key: str) -> str:
        return f"{self.place}.{key}" if self.place else key


def _is(value: object, kind: type[object]) -> bool:
    """Of the type; a bool is no number, a whole number is one; inf and NaN are none."""
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, kind)
