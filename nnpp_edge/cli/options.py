"""How commands are made of functions, and the options that several of them share.

A parameter of the function is ``Annotated[…]`` with its type; names that begin with a hyphen, where
its own does not serve; a click type, by default that of `_KINDS`; its help; and a dict of more
words for click. Those before ``/`` are arguments, and one without a default is required. One whose
type is a dataclass is made of the options that are its fields; one whose type is a record of
`runtime.options` holds what was given of the options that are explained there.
"""

import inspect
import math
import pkgutil
import re
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, is_typeddict

import click
from msgspec import Meta

from nnpp_edge.runtime.errors import MissingExtraError, optional_module
from nnpp_edge.runtime.options import STEP_COSTS

MOST = 2**31 - 1
"""No count may be larger; no library's integers are narrower."""
LARGEST = 1e9
"""No length, weight or time may be larger, whatever its unit: products of them stay finite."""
LARGEST_SIDE = 1 << 15
"""Cells along a side of a map that is made or cut out."""
SAMPLE = "sample:"


def command(
    name: str, kind: type[click.Command] = click.Command, **more: Any
) -> Callable[[Callable[..., None]], click.Command]:
    """Make a command of a function."""

    def make(function: Callable[..., None]) -> click.Command:
        signature = inspect.signature(function)
        params = {each.name: _params(each) for each in signature.parameters.values()}

        def call(**given: object) -> None:
            taken: dict[str, object] = {}
            for each in signature.parameters.values():
                values = {str(own.name): given[str(own.name)] for own in params[each.name]}
                known = {name: value for name, value in values.items() if value is not None}
                group = each.annotation
                taken[each.name] = group(**known) if _is_group(group) else values[each.name]
            bound = inspect.BoundArguments(signature, taken)
            function(*bound.args, **bound.kwargs)

        all_params = list(chain(*params.values()))
        return kind(name, callback=call, params=all_params, help=inspect.getdoc(function), **more)

    return make


def _is_group(kind: object) -> bool:
    return is_typeddict(kind) or is_dataclass(kind)


def _params(given: inspect.Parameter) -> list[click.Parameter]:
    """Of one of a function's parameters: of a group those of its fields that are explained."""
    group = given.annotation
    rows = [(given.name, group, given.default)]
    if is_dataclass(group):
        rows = [(field.name, field.type, field.default) for field in fields(group)]
    elif is_typeddict(group):
        hints = group.__annotations__.items()
        rows = [(name, hint, None) for name, hint in hints if "Annotated" in str(hint)]
    make = click.Argument if given.kind is given.POSITIONAL_ONLY else click.Option
    return [_param(make, *row) for row in rows]


def _param(
    make: type[click.Option | click.Argument], name: str, annotation: object, default: object
) -> click.Parameter:
    found = [each for each in (annotation, *get_args(annotation)) if hasattr(each, "__metadata__")]
    python_type, *said = get_args(found[0]) if found else (annotation,)
    required = default in (MISSING, inspect.Parameter.empty)
    words: dict[str, Any] = {"required": required, "type": _KINDS.get(python_type)}
    if make is click.Option and not required:
        words["default"] = default
    word = "--" + re.sub("_(s|m|deg)$", "", name).replace("_", "-")  # a unit ends a key's name
    if python_type is bool:
        words["is_flag"] = True
        word += word.replace("--", "/--no-") if default is None else ""
    names = []
    for each in said:
        match each:
            case Meta():
                words |= _of_meta(each)
            case dict():
                words |= each
            case str() if each.startswith("-"):
                names.append(each)
            case str():
                words["help"] = each
            case _:
                words["type"] = each
    if make is click.Option and not any(each.startswith("--") for each in names):
        names.append(word)
    return make([*names, name], **words)


def _of_meta(said: Meta) -> dict[str, object]:
    """What a type of `runtime.options` says of its option."""
    words: dict[str, object] = {"help": said.description} if said.description else {}
    if said.extra:
        words["type"] = click.Choice(list(said.extra["choices"]))
    elif (least := said.gt if said.ge is None else said.ge) is not None:
        words["type"] = Real(least, said.le or LARGEST, min_open=said.ge is None)
    return words


class Named(click.Path):
    """A path that is not empty, as pathlib takes an empty one for the folder we are in; a `MAP` may
    be a sample.
    """

    def convert(  # type: ignore[override]
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> object:
        word = str(value)
        if not word:
            self.fail("wanted a path, got nothing", param, ctx)
        if self is not MAP or not word.startswith(SAMPLE):
            return super().convert(word, param, ctx)
        from nnpp_edge.terrain.dem import sample_path

        try:
            return sample_path(word.removeprefix(SAMPLE))
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Real(click.FloatRange):
    """A finite number in a range; click's own takes NaN for one."""

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = float(super().convert(value, param, ctx))  # type: ignore[arg-type]  # click takes any
        if not math.isfinite(number):
            self.fail(f"wanted a finite number, got {number}", param, ctx)
        return number


class Parsed(click.ParamType):  # type: ignore[type-arg]  # click has made it generic, its older versions have not
    """A parameter that a function makes of a word.

    Its ValueError becomes a line that says what was wanted and what came; without words for that,
    the error's own.
    """

    def __init__(self, name: str, wanted: str, parse: Callable[[str], object]) -> None:
        self.name = name
        self.wanted = wanted
        self.parse = parse

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> object:
        """Parse a word; a value that is none, such as a default, stays."""
        if not isinstance(value, str):
            return value
        try:
            return self.parse(value)
        except ValueError as error:
            words = f"wanted {self.wanted}, got {value!r}" if self.wanted else str(error)
            self.fail(words, param, ctx)


class Setting(NamedTuple):
    """A value that takes the place of another."""

    word: str
    """As it was given."""
    values: dict[str, object]
    """The key, or its first part, with the value or the table that holds it."""


class SettingType(click.ParamType):  # type: ignore[type-arg]  # as above
    """``KEY=VALUE`` in TOML; the keys are fields of a class, ``MODULE:NAME``, and some more."""

    name = "KEY=VALUE"

    def __init__(self, kind: str, example: str, *more: str, bare: bool = False) -> None:
        # whether words need no quotes
        self.kind = kind
        self.example = example
        self.more = more
        self.bare = bare

    def keys(self) -> list[str]:
        """Names of what may be set."""
        return [*pkgutil.resolve_name(self.kind).__annotations__, *self.more]

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> Setting:
        text = str(value)
        if self.bare:
            text = re.sub(r"=(?!true$|false$)([A-Za-z][\w.-]*)$", r'="\1"', text)
        try:
            ((key, content),) = tomllib.loads(text).items()
        except (ValueError, RecursionError):
            self.fail(
                f"wanted KEY=VALUE in TOML, such as {self.example}, got {value!r}", param, ctx
            )
        if key not in (keys := self.keys()):
            self.fail(f"{key} is unknown: wanted one of {', '.join(keys)}", param, ctx)
        return Setting(str(value), {key: content})


def _whole(least: int, most: int, word: str) -> int:
    if not least <= (number := int(word)) <= most:
        raise ValueError
    return number


def _bytes(word: str) -> float:
    found = re.fullmatch(r"([\d.]+) ?([kMGT]?)(i)?B?", word)
    if found is None or not (number := float(found[1])):
        raise ValueError
    return number * float((1024 if found[3] else 1000) ** " kMGT".index(found[2] or " "))


def _model(word: str) -> str:
    from nnpp_edge.runtime.network.model_file import model_path

    model_path(word)  # refused where there is neither, needed or not
    return word


def joined(item: Callable[[str], object]) -> Callable[[str], object]:
    """Parse words that are joined by commas."""
    return lambda word: tuple(map(item, word.split(",")))


PATH = Named(path_type=Path)
MAP = Named(path_type=Path)
"""A file, or ``sample:NAME`` for a map that travels with the package."""
NEW_FILE = Named(path_type=Path, dir_okay=False)
FOLDER = Named(path_type=Path, file_okay=False)
COUNT = click.IntRange(1, MOST)
SEED = click.IntRange(0, 2**32 - 1)
POSITIVE = Real(0.0, LARGEST, min_open=True)
NOT_NEGATIVE = Real(0.0, LARGEST)
SHARE = Real(0.0, 1.0)
RATE = Real(0.001, 1000.0)
MODEL = Parsed("NAME|FILE", "", _model)
NAMES = Parsed("NAME,…", "names joined by commas", joined(str.strip))
COUNTS = Parsed(
    "N,…", "whole numbers of at least 1, joined by commas", joined(partial(_whole, 1, MOST))
)
SIZES = Parsed(
    "N,…",
    f"sides of 2 to {LARGEST_SIDE} cells, joined by commas",
    joined(partial(_whole, 2, LARGEST_SIDE)),
)
MANY = {"multiple": True}
_KINDS: dict[object, object] = {
    Path: PATH,
    Path | None: NEW_FILE,
    int: COUNT,
    int | None: COUNT,
    float | None: POSITIVE,
}
"""Of a parameter that names no click type."""

AsJson = Annotated[bool, "--json", "Print JSON for programs."]
Seed = Annotated[int, SEED, "Seed of every random choice."]
Model = Annotated[str, MODEL, "Name of a shipped network, or an ONNX file."]
Memory = Annotated[
    float | None,
    Parsed("SIZE", "a size such as 2GB or 500MiB", _bytes),
    "Memory that a map may take; a larger raster is read by windows. By default what is free.",
]
CellSize = Annotated[float | None, "Side of a cell in metres, where the file does not say."]
Rescale = Annotated[
    float | None,
    "Judge cells as if they were this many metres wide with heights scaled alike: slopes stay, "
    "roughness and steps change.",
]
TerrainFiles = Annotated[tuple[Path, ...], MAP, MANY, "Elevation file. May be repeated."]
StepCost = Annotated[
    str,
    click.Choice(list(STEP_COSTS)),
    "Price of a step: by the map's costs, or by the slope it leads up or down; time and energy by "
    "the table [mobility] of --vehicle or --mobility.",
]


def check_outputs(
    *outputs: tuple[str, Path | None],
    more_inputs: Iterable[str | Path] = (),
    make_folders: bool = False,
) -> None:
    """`nnpp_edge.files.check_outputs` against every file that the running command's other options
    name.
    """
    from nnpp_edge.files import check_outputs

    context = click.get_current_context()
    names = {name for name, _ in outputs}
    read = [
        context.params[p.name]
        for p in context.command.params
        if p.name and not names.intersection(p.opts)
    ]
    check_outputs(outputs, _paths([*read, *more_inputs]), make_folders=make_folders)


def files_in(folder: Path | None, names: Iterable[str]) -> list[Path]:
    """Those to write in the folder of --output, which is made, if it was given; checked as by
    `check_outputs`.
    """
    paths = [] if folder is None else [folder / name for name in names]
    check_outputs(*(("--output", path) for path in paths), make_folders=True)
    return paths


def can_draw(name: object) -> bool:
    """Whether a picture of this name can be drawn beside other files; a warning says what is
    missing.
    """
    try:
        optional_module("matplotlib", str(name), "viz")
    except MissingExtraError as error:
        warnings.warn(f"no picture is drawn: {error}", stacklevel=2)
        return False
    return True


def _paths(values: Iterable[object]) -> Iterator[Path]:
    """Those among an option's values, and in its lists."""
    for value in values:
        if isinstance(value, tuple | list):
            yield from _paths(value)
        elif isinstance(value, str | Path):
            yield Path(str(value).removeprefix("replay:"))
