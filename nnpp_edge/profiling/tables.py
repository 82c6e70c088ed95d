"""Types of a profile's tables: ranges of numbers, and checks that name the key."""

from collections.abc import Collection
from typing import Annotated

import msgspec
from msgspec import Meta

from nnpp_edge.runtime.errors import InvalidQueryError

LARGEST = 1e9
"""Neither inf nor NaN is a number here, and products of two stay finite."""

Whole = Annotated[int, Meta(ge=0, le=2**31 - 1)]
Count = Annotated[int, Meta(ge=1, le=2**31 - 1)]
Core = Annotated[int, Meta(ge=0, le=1023)]
"""As many as the kernel's set of cores holds."""
Finite = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Meta(gt=0.0, le=LARGEST)]
Names = Annotated[tuple[str, ...], Meta(min_length=1)]


class ProfileError(InvalidQueryError):
    """A profile that cannot be used; the message names the file and the key."""


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A table of a profile. Types are checked where it is read; what no type says, where it is made."""

    def refuse_unless(self, fits: bool, key: str, wanted: str) -> None:
        """ValueError about a key's value."""
        if not fits:
            raise ValueError(f"{key}: wanted {wanted}, got {getattr(self, key)!r}")

    def check_choice(self, key: str, choices: Collection[str]) -> None:
        """Refuse a value that is none of these."""
        self.refuse_unless(getattr(self, key) in choices, key, f"one of {', '.join(choices)}")

    def check_different(self, *keys: str) -> None:
        """Refuse lists that hold a value twice."""
        for key in keys:
            values = getattr(self, key)
            self.refuse_unless(len(set(values)) == len(values), key, "different values")
