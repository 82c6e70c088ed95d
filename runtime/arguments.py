"""Whether arguments are of the kinds that a signature names: what is not is refused before anything looks at it.

A public function, method or dataclass is `checked` against its own annotations, in a microsecond or two a call:
numbers, text, truth values, paths, instances of classes, sequences of these. Arrays and cells have their own checks.
"""

import functools
import inspect
import types
from collections.abc import Callable, Iterable, Sequence
from numbers import Integral, Real
from pathlib import Path
from typing import NamedTuple, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from nnpp_edge.runtime.errors import NnppEdgeError, shown

F = TypeVar("F", bound=Callable[..., object])
C = TypeVar("C")
_LARGEST = 1 << 63
"""Whole numbers from here on fit into no kernel."""


class Kind(NamedTuple):
    """A kind of argument."""

    exact: frozenset[type]
    """Types that need no second look."""
    accepts: Callable[[object], bool]
    words: str
    """For people: the kind that is wanted."""


def checked(error: type[NnppEdgeError]) -> Callable[[F], F]:
    """Decorator: a call whose arguments are not of the annotated kinds raises this error, in one line."""

    def of(entry: F) -> F:
        if isinstance(entry, type) and not issubclass(entry, tuple):
            entry.__init__ = _guarded(entry.__init__, error)  # type: ignore[method-assign, assignment]  # a dataclass has made it
            return entry
        return cast(F, _guarded(entry, error))

    return of


def formerly(**advice: str) -> Callable[[type[C]], type[C]]:
    """Decorator of a class: attributes that it had once raise AttributeError with what to write instead."""

    def of(kind: type[C]) -> type[C]:
        def missing(self: C, name: str) -> object:
            instead = f": {advice[name]}" if name in advice else ""
            raise AttributeError(f"{kind.__name__} has no attribute {name!r}{instead}", name=name, obj=self)

        kind.__getattr__ = missing  # type: ignore[attr-defined]
        return kind

    return of


def is_real(value: object) -> bool:
    """Whether it is a number, of Python or NumPy; truth values and numbers beyond 64 bits are none."""
    return _is_whole(value) or (isinstance(value, Real) and not isinstance(value, Integral))


def _guarded(entry: Callable[..., object], error: type[NnppEdgeError]) -> Callable[..., object]:
    @functools.cache
    def kinds() -> dict[str, Kind | None]:
        """Read at the first call, when all that annotations name is there."""
        hints = get_type_hints(entry)
        return {name: _kind(hints.get(name)) for name in inspect.signature(entry).parameters}

    def check(name: str, kind: Kind, value: object) -> None:
        if not kind.accepts(value):
            raise error(f"{name} must be {kind.words}, got {shown(value)}")

    @functools.wraps(entry)
    def call(*args: object, **given: object) -> object:
        known = kinds()
        for value, (name, kind) in zip(args, known.items(), strict=False):
            if kind is not None and type(value) not in kind.exact:
                check(name, kind, value)
        for name, value in given.items():
            if (kind := known.get(name)) is not None and type(value) not in kind.exact:
                check(name, kind, value)
        return entry(*args, **given)

    return call


def _kind(hint: object) -> Kind | None:
    """The kind that an annotation accepts; None where that is for others to say."""
    if hint in _KINDS:
        return _KINDS[hint]
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        known = [kind for kind in map(_kind, inner) if kind is not None]
        exact, words = frozenset[type]().union(*(kind.exact for kind in known)), " or ".join(k.words for k in known)
        return (
            Kind(exact, lambda value: any(k.accepts(value) for k in known), words)
            if len(known) == len(inner)
            else None
        )
    if origin is Callable or hint is Callable:
        return Kind(frozenset(), callable, "callable")
    if origin is dict:
        return _kind(dict)
    if origin is tuple:
        return _sequence(_kind(inner[0]), None if inner[-1] is ... else len(inner))
    if origin in (Sequence, Iterable):
        return _sequence(_kind(inner[0]))
    if origin is not None or not isinstance(hint, type) or issubclass(hint, np.ndarray):
        return None
    words = f"{'an' if hint.__name__[0] in 'AEIO' else 'a'} {hint.__name__}"
    if getattr(hint, "_is_protocol", False):
        names = [name for name, value in vars(hint).items() if callable(value) and not name.startswith("_")]
        return Kind(frozenset(), lambda value: all(hasattr(value, name) for name in names), words)
    return Kind(frozenset([hint]), lambda value: isinstance(value, hint), words)


def _sequence(of: Kind | None, length: int | None = None) -> Kind:
    def accepts(value: object) -> bool:
        if not isinstance(value, Sequence | np.ndarray | set | frozenset) or length not in (None, len(value)):
            return False
        return of is None or all(type(each) in of.exact or of.accepts(each) for each in value)

    words = "a sequence" if length is None else f"{length} values"
    return Kind(frozenset(), accepts, words if of is None else f"{words}, each {of.words}")


def _is_whole(value: object) -> bool:
    whole = type(value) is int or (isinstance(value, Integral) and not isinstance(value, bool))
    return whole and -_LARGEST <= int(value) < _LARGEST  # type: ignore[call-overload]


_KINDS: dict[object, Kind | None] = {
    int: Kind(frozenset(), _is_whole, "a whole number"),
    float: Kind(frozenset([float]), is_real, "a number"),
    bool: Kind(frozenset([bool]), lambda value: isinstance(value, np.bool_), "True or False"),
    str: Kind(frozenset([str]), lambda value: isinstance(value, str), "text"),
    Path: Kind(frozenset(), lambda value: isinstance(value, Path), "a path"),
    type(None): Kind(frozenset([type(None)]), lambda value: value is None, "None"),
    tuple[int, int]: None,
}
