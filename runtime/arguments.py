"""Whether arguments are of the kinds that a signature names, and numbers in their ranges: what is
not is refused before anything looks at it.

A public function, method, dataclass or record of options is `checked` against its own annotations,
in a microsecond or two a call: numbers, text, truth values, paths, instances of classes, sequences
of these. Arrays and cells have their own checks.
"""

import builtins
import functools
import inspect
import math
import sys
import types
from collections.abc import Callable, Iterable, Sequence
from itertools import chain
from numbers import Integral, Real
from pathlib import Path
from typing import (
    Any,
    NamedTuple,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np

from nnpp_edge.runtime.errors import NnppEdgeError, shown

F = TypeVar("F", bound=Callable[..., object])
_LARGEST = 1 << 63
"""Whole numbers from here on fit into no kernel."""
Range = tuple[float, float, str]
"""The least and the greatest of a number, and what it must be, in words."""
MOST = sys.float_info.max
ABOVE_0: Range = math.ulp(0.0), MOST, "a number above 0"
FROM_0: Range = 0.0, MOST, "a number of at least 0"
_UNIONS = (Union, types.UnionType)
_SEQUENCES = (Sequence, Iterable, tuple)


def checked(error: type[NnppEdgeError]) -> Callable[[F], F]:
    """Decorator: a call whose arguments are not of the annotated kinds raises this error, in one
    line.
    """

    def of(entry: F) -> F:
        if isinstance(entry, type) and not issubclass(entry, dict):
            entry.__init__ = _guarded(entry.__init__, error)  # type: ignore[method-assign, assignment]  # a dataclass has made it
            return entry
        return cast(F, _guarded(entry, error))

    return of


def check_ranges(record: object, error: type[NnppEdgeError], **ranges: Range) -> None:
    """This error for the first number of a record that is out of its range; None is in any."""
    for name, (least, most, wanted) in ranges.items():
        value = getattr(record, name)
        if value is not None and not least <= value <= most:
            raise error(f"{name} must be {wanted}, got {value}")


def is_real(value: object) -> bool:
    """Whether it is a number, of Python or NumPy; truth values and numbers beyond 64 bits
    are none.
    """
    return _is_whole(value) or (isinstance(value, Real) and not isinstance(value, Integral))


def _guarded(entry: Callable[..., object], error: type[NnppEdgeError]) -> Callable[..., object]:
    @functools.cache
    def kinds() -> dict[str, tuple[object, set[object]]]:
        """Annotations, and types that need no second look; read at the first call, when all they
        name is there.
        """
        given = inspect.get_annotations(entry)
        given.pop("return", None)
        space = getattr(entry, "__globals__", None) or vars(sys.modules[entry.__module__])
        named = get_type_hints(types.SimpleNamespace(__annotations__=given), space, _Names(space))
        found = {}
        for name in named if is_typeddict(entry) else inspect.signature(entry).parameters:
            hint = named.get(name)
            alike = get_args(hint) if get_origin(hint) in _UNIONS else (hint,)
            exact = {np.ndarray if get_origin(each) is np.ndarray else each for each in alike}
            found[name] = (hint, exact - {int})
        return found

    @functools.wraps(entry)
    def call(*args: object, **given: object) -> object:
        known = kinds()
        for name, value in chain(zip(known, args, strict=False), given.items()):
            if name not in known and is_typeddict(entry):
                raise TypeError(f"no option is named {name}: wanted one of {', '.join(known)}")
            hint, exact = known.get(name, (None, ()))
            if hint is not None and type(value) not in exact and not _kind(hint).fits(value):
                raise error(f"{name} must be {_kind(hint).words}, got {shown(value)}")
        return entry(*args, **given)

    return call


class _ByName(type):
    """Kind of a class that is known by its name alone: its module is loaded by whoever needs it."""

    def __instancecheck__(cls, value: object) -> bool:
        return any(kind.__name__ == cls.__name__ for kind in type(value).__mro__)


class _Names(dict[str, object]):
    """What annotations may name: of classes imported for type checkers alone the names."""

    def __missing__(self, name: str) -> object:
        if hasattr(builtins, name):
            raise KeyError(name)
        return _ByName(name, (), {})


class _Kind(NamedTuple):
    """A kind of value."""

    words: str
    """For people."""
    fits: Callable[[Any], bool]
    """Whether a value is of it."""


@functools.cache
def _kind(hint: object) -> _Kind:
    """The kind that an annotation names; everything fits where that is for others to say."""
    if hint in _KINDS:
        return _KINDS[hint]
    origin = get_origin(hint)
    inner = get_args(hint)
    if origin is Callable:
        return _Kind("callable", callable)
    if origin in _UNIONS:
        kinds = [_kind(each) for each in inner]
        words = " or ".join(kind.words for kind in kinds)
        return _Kind(words, lambda value: any(kind.fits(value) for kind in kinds))
    if origin in _SEQUENCES:
        return _sequence(_kind(inner[0]), len(inner) if origin is tuple and ... not in inner else 0)
    name = getattr(origin or hint, "__name__", "")
    words = f"{'an' if name[0] in 'AEIO' else 'a'} {name}"
    kind = dict if origin is dict else hint
    if not isinstance(kind, type) or issubclass(kind, np.ndarray):
        return _Kind(words, lambda value: True)
    return _Kind(words, lambda value: isinstance(value, kind))


def _sequence(each: _Kind, length: int) -> _Kind:
    """A sequence of one kind; of so many, or any number for 0."""
    words = f"{length} values" if length else "a sequence"

    def fits(value: object) -> bool:
        if not isinstance(value, Sequence | np.ndarray | set | frozenset):
            return False
        return length in (0, len(value)) and all(map(each.fits, value))

    return _Kind(f"{words}, each {each.words}" if each.words else words, fits)


def _is_whole(value: object) -> bool:
    whole = type(value) is int or (isinstance(value, Integral) and not isinstance(value, bool))
    return whole and -_LARGEST <= int(value) < _LARGEST  # type: ignore[call-overload]


_KINDS: dict[object, _Kind] = {
    int: _Kind("a whole number", _is_whole),
    float: _Kind("a number", is_real),
    bool: _Kind("True or False", lambda value: isinstance(value, bool | np.bool_)),
    str: _Kind("text", lambda value: isinstance(value, str)),
    Path: _Kind("a path", lambda value: isinstance(value, Path)),
    type(None): _Kind("None", lambda value: value is None),
    tuple[int, int]: _Kind("", lambda value: True),
}
