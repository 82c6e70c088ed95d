"""Options and arguments that several commands share."""

from __future__ import annotations

import functools
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import click

if TYPE_CHECKING:
    import numpy as np
    from _typeshed import DataclassInstance
    from numpy.typing import NDArray

    from nnpp_edge.runtime.terrain.traversability import Traversability
    from nnpp_edge.terrain.dem import Dem
    from nnpp_edge.terrain.dem_windows import DemWindows

Command = TypeVar("Command", bound=Callable[..., object])

MOST = 2**31 - 1
"""No count may be larger; no library's integers are narrower."""
LARGEST = 1e9
"""No length, weight or time may be larger, whatever its unit: products of them stay finite."""
LARGEST_SIDE = 1 << 15
"""Cells along a side of a map that is made or cut out."""
COUNT = click.IntRange(1, MOST)


class Named(click.Path):
    """A path that is not empty; pathlib takes an empty one for the folder we are in."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> object:  # type: ignore[override]
        """Parse a word."""
        if not str(value):
            self.fail("wanted a path, got nothing", param, ctx)
        return super().convert(value, param, ctx)  # type: ignore[arg-type]  # click takes any


class Map(Named):
    """A file with a map, or ``sample:NAME`` for one that travels with the package."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> object:  # type: ignore[override]
        """Parse a word."""
        if not str(value).startswith(SAMPLE):
            return super().convert(value, param, ctx)
        from nnpp_edge.runtime.errors import InvalidQueryError
        from nnpp_edge.terrain.shipped import sample_path

        try:
            return sample_path(str(value).removeprefix(SAMPLE))
        except InvalidQueryError as error:
            self.fail(str(error), param, ctx)


SAMPLE = "sample:"
PATH = Named(path_type=Path)
MAP = Map(path_type=Path)
NEW_FILE = Named(path_type=Path, dir_okay=False)
FOLDER = Named(path_type=Path, file_okay=False)


class Real(click.FloatRange):
    """A finite number in a range; click's own takes NaN for one."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse a word."""
        number = float(super().convert(value, param, ctx))  # type: ignore[arg-type]  # click takes any
        if not math.isfinite(number):
            self.fail(f"wanted a finite number, got {number}", param, ctx)
        return number


POSITIVE = Real(0.0, LARGEST, min_open=True)
NOT_NEGATIVE = Real(0.0, LARGEST)
SHARE = Real(0.0, 1.0)
RATE = Real(0.001, 1000.0)
SEED = click.IntRange(0, 2**32 - 1)


class ModelName(click.ParamType):  # type: ignore[type-arg]  # as below
    """A shipped network's name or an ONNX file; refused where there is neither, needed or not."""

    name = "NAME|FILE"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Look for the file; ModelError without one."""
        from nnpp_edge.runtime.network.model_file import model_path

        model_path(str(value))
        return str(value)


class Parsed(click.ParamType):  # type: ignore[type-arg]  # click has made it generic, its older versions have not
    """A parameter that a function makes of a word; its ValueError becomes a line that says what was wanted and what
    came.
    """

    def __init__(self, name: str, wanted: str, parse: Callable[[str], object]) -> None:
        self.name, self.wanted, self.parse = name, wanted, parse

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> object:
        """Parse a word; a value that is none, such as a default, stays."""
        if not isinstance(value, str):
            return value
        try:
            return self.parse(value)
        except ValueError:
            self.fail(f"wanted {self.wanted}, got {value!r}", param, ctx)


class Setting(NamedTuple):
    """A value that takes the place of another."""

    word: str
    """As it was given."""
    values: dict[str, object]
    """The key, or its first part, with the value or the table that holds it."""


class SettingType(click.ParamType):  # type: ignore[type-arg]  # as above
    """``KEY=VALUE`` in TOML; the keys are asked for when they are needed."""

    name = "KEY=VALUE"

    def __init__(self, keys: Callable[[], list[str]], example: str, *, bare: bool = False) -> None:
        self.keys, self.example, self.bare = keys, example, bare  # whether words need no quotes

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Setting:
        """Parse a word."""
        text = re.sub(r"=(?!true$|false$)([A-Za-z][\w.-]*)$", r'="\1"', str(value)) if self.bare else str(value)
        try:
            ((key, content),) = tomllib.loads(text).items()
        except (ValueError, RecursionError):
            self.fail(f"wanted KEY=VALUE in TOML, such as {self.example}, got {value!r}", param, ctx)
        if key not in (keys := self.keys()):
            self.fail(f"{key} is unknown: wanted one of {', '.join(keys)}", param, ctx)
        return Setting(str(value), {key: content})


def _cell(word: str) -> tuple[int, int]:
    row, col = map(int, word.split(","))
    return row, col


def _size(word: str) -> int | tuple[int, int]:
    rows, cols = map(int, word.split("x")) if "x" in word else (int(word), int(word))
    if not 2 <= min(rows, cols) <= max(rows, cols) <= LARGEST_SIDE:
        raise ValueError
    return rows if rows == cols else (rows, cols)


def _bytes(word: str) -> float:
    found = re.fullmatch(r"([\d.]+) ?([kMGT]?)(i?)B?", word)
    if found is None:
        raise ValueError
    size: float = float(found[1]) * (1024 if found[3] else 1000) ** " kMGT".index(found[2] or " ")
    if size <= 0.0:
        raise ValueError
    return size


def _count(word: str) -> int:
    if not 1 <= (count := int(word)) <= MOST:
        raise ValueError
    return count


def _joined(item: Callable[[str], object]) -> Callable[[str], object]:
    return lambda word: tuple(map(item, word.split(",")))


Numbers = functools.partial(Parsed, "N,…", "numbers joined by commas", _joined(int))
Cell = functools.partial(Parsed, "R,C", "ROW,COL as two whole numbers", _cell)
Names = functools.partial(Parsed, "NAME,…", "names joined by commas", _joined(str.strip))
Counts = functools.partial(Parsed, "N,…", "whole numbers of at least 1, joined by commas", _joined(_count))
Sizes = functools.partial(
    Parsed, "N|RxC,…", f"sides of 2 to {LARGEST_SIDE} cells, or ROWSxCOLS, joined by commas", _joined(_size)
)
"""Sides of square maps as ints, others as pairs of ints."""

as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")
view = click.option(
    "--view",
    metavar="WHERE",
    help="Map and path in rerun: 'here' starts a viewer, rerun+http://HOST:9876/proxy is one, FILE.rrd is written.",
)
trace = click.option(
    "--trace", type=NEW_FILE, help="Write what ran when, stage by stage, as JSON for ui.perfetto.dev."
)
seed = click.option("--seed", type=SEED, default=1, help="Seed of every random choice.")
model = click.option("--model", type=ModelName(), default="edge", help="Name of a shipped network, or an ONNX file.")
memory = click.option(
    "--memory",
    type=Parsed("SIZE", "a size such as 2GB or 500MiB", _bytes),
    help="Memory that a map may take; a larger raster is read by windows. By default what is free.",
)
cell_size = click.option("--cell-size", type=POSITIVE, help="Side of a cell in metres, where the file does not say.")
allow_vrt = click.option("--allow-vrt", is_flag=True, help="Read a GDAL VRT, too, of GeoTIFFs in its own folder.")
omega = click.option(
    "--omega", type=NOT_NEGATIVE, default=0.011, help="Weight of the cost against length, per grey level."
)
corner_cutting = click.option(
    "--corner-cutting/--no-corner-cutting", default=True, help="Allow diagonal steps beside impassable cells."
)
hillshade = click.option("--hillshade", is_flag=True, help="Draw the relief in place of the cost.")
rescale = click.option(
    "--rescale", type=POSITIVE, help="Make cells this many metres wide and scale heights alike, so that slopes stay."
)

STEP_COSTS = ("paper", "tobler", "irmischer", "linear", "time", "energy")
step_cost = click.option(
    "--step-cost",
    type=click.Choice(STEP_COSTS),
    default="paper",
    help="What a step costs: by the map's costs, or by the slope it leads up or down; time and energy as the table "
    "[mobility] of --vehicle or --mobility says.",
)


def together(*options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """One decorator for several options, in this order."""

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def terrain_files(default: str = "") -> Callable[[Command], Command]:
    """How they are read: `terrain`, `cell_size`, `rescale`, `allow_vrt`; the help says what `default` is."""
    files = click.option("--terrain", multiple=True, type=MAP, help=f"Elevation file, or several{default}.")
    return together(files, cell_size, rescale, allow_vrt)


def _limit_keys() -> list[str]:
    from nnpp_edge.runtime.terrain.traversability import Traversability

    return [field.name for field in fields(Traversability) if not field.name.endswith("_weight")]


@dataclass(frozen=True)
class TerrainOptions:
    """How an elevation map is read, and by which limits it becomes a cost map. The options' values, as given."""

    cell_size: float | None
    vertical_scale: float | None
    rescale: float | None
    allow_vrt: bool
    limit: tuple[Setting, ...]
    workload: str | None

    @property
    def limits_given(self) -> bool:
        """Whether the user has set a limit or a workload."""
        return bool(self.limit or self.workload)

    def read(self, path: Path) -> Dem:
        """The elevation map in a file."""
        from nnpp_edge.terrain.dem import read_dem

        dem = read_dem(path, self.cell_size, self.vertical_scale, allow_vrt=self.allow_vrt)
        return dem if self.rescale is None else dem.rescaled(self.rescale)

    def open(self, path: Path) -> AbstractContextManager[DemWindows]:
        """The elevation map in a file, to be read by windows."""
        from nnpp_edge.terrain.dem_windows import open_dem

        return open_dem(path, self.cell_size, self.vertical_scale, rescale_m=self.rescale, allow_vrt=self.allow_vrt)

    def limits(self) -> Traversability:
        """The limits of the cost map; UsageError where the workload sets one that was given too."""
        from nnpp_edge.runtime.terrain.traversability import Traversability
        from nnpp_edge.terrain.workloads import SOFT
        from nnpp_edge.terrain.workloads import workload as limits_of

        values = {name: value for each in self.limit for name, value in each.values.items()}
        limits = Traversability(**values)  # type: ignore[arg-type]  # it checks them
        if self.workload is None:
            return limits
        twice = [name for name in values if name in ("slope_limit_deg", "hard_slope_deg")]
        if twice and self.workload != SOFT:
            raise click.UsageError(f"--workload {self.workload} sets the slope limits: leave out --limit {twice[0]}")
        return limits_of(self.workload, limits)


def gathered(name: str, kind: type[DataclassInstance]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the values of the options that `kind` has fields for as one `kind`, under this name."""

    def gather(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def with_gathered(**values: object) -> None:
            own = {field.name: values.pop(field.name) for field in fields(kind)}
            command(**values, **{name: kind(**own)})

        return with_gathered

    return gather


terrain = together(
    cell_size,
    click.option("--vertical-scale", type=POSITIVE, help="Metres per grey level, for 16-bit PNG."),
    rescale,
    allow_vrt,
    click.option(
        "--limit",
        type=SettingType(_limit_keys, "hard_slope_deg=20"),
        multiple=True,
        help="Set a limit of the cost; by default slope_limit_deg=30, roughness_limit_m=0.6 and step_limit_m=0.2. "
        "Cells beyond hard_slope_deg, hard_roughness_m or hard_step_m are impassable. May be repeated.",
    ),
    click.option(
        "--workload",
        help="soft (the paper's cost), or limitN: φ_s = N degrees, and steeper cells are impassable.",
    ),
    gathered("terrain", TerrainOptions),
)
"""How an elevation map is read and becomes a cost map; the command is given them as `terrain`."""


def check_outputs(
    *outputs: tuple[str, Path | None], more_inputs: Iterable[str | Path] = (), make_folders: bool = False
) -> None:
    """`nnpp_edge.files.check_outputs` against every file that the running command's other options name."""
    from nnpp_edge.files import check_outputs

    context, names = click.get_current_context(), {name for name, _ in outputs}
    read = [context.params[p.name] for p in context.command.params if p.name and not names.intersection(p.opts)]
    check_outputs(outputs, _paths([*read, *more_inputs]), make_folders=make_folders)


def shade_of(dem: Dem) -> NDArray[np.uint8]:
    """The relief that --hillshade asks for."""
    from nnpp_edge.viz.picture import hillshade

    return hillshade(dem.elevation, dem.cell_size_m, dem.cell_width_m)


def view_file(view: str | None) -> Path | None:
    """The file that --view asks for."""
    return Path(view) if view is not None and view.endswith(".rrd") else None


def _paths(values: Iterable[object]) -> Iterator[Path]:
    """Those among an option's values, and in its lists."""
    for value in values:
        if isinstance(value, tuple | list):
            yield from _paths(value)
        elif isinstance(value, str | Path):
            yield Path(str(value).removeprefix("replay:"))


def given_options() -> list[str]:
    """Names of the running command's options that the user has given."""
    context = click.get_current_context()
    default = click.core.ParameterSource.DEFAULT
    return [name for name in context.params if context.get_parameter_source(name) is not default]
