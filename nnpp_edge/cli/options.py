"""Options and arguments that several commands share."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])

PATH = click.Path(path_type=Path)
NEW_FILE = click.Path(path_type=Path, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)


class Cell(click.ParamType):
    """`R,C`: two whole numbers."""

    name = "R,C"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Parse, or fail with what came."""
        if isinstance(value, tuple):
            return value
        try:
            row, col = (int(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"wanted ROW,COL as two whole numbers, got {value!r}", param, ctx)
        return row, col


class Numbers(click.ParamType):
    """Numbers joined by commas."""

    name = "N,…"

    def __init__(self, kind: type = int) -> None:
        self.kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[Any, ...]:
        """Parse, or fail with what came."""
        if isinstance(value, tuple):
            return value
        try:
            return tuple(self.kind(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"wanted numbers joined by commas, got {value!r}", param, ctx)


class Sizes(click.ParamType):
    """Sides of square maps, or ROWSxCOLS, joined by commas."""

    name = "N|RxC,…"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[Any, ...]:
        """Parse to ints and pairs of ints, or fail with what came."""
        if isinstance(value, tuple):
            return value
        try:
            parts = [tuple(int(side) for side in part.split("x")) for part in str(value).split(",")]
        except ValueError:
            parts = [()]
        if not all(len(sides) in (1, 2) and min(sides) >= 2 for sides in parts):
            self.fail(f"wanted sides of at least 2 cells, or ROWSxCOLS, joined by commas, got {value!r}", param, ctx)
        return tuple(sides[0] if len(set(sides)) == 1 else sides for sides in parts)


class Names(click.ParamType):
    """Names joined by commas."""

    name = "NAME,…"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Parse."""
        return value if isinstance(value, tuple) else tuple(part.strip() for part in str(value).split(","))


def _all(*options: Callable[[F], F]) -> Callable[[F], F]:
    def add(function: F) -> F:
        for option in reversed(options):
            function = option(function)
        return function

    return add


as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")
view = click.option(
    "--view", metavar="WHERE",
    help="Map and path in rerun: 'here' starts a viewer, rerun+http://HOST:9876/proxy is one, FILE.rrd is written.",
)  # fmt: skip
seed = click.option("--seed", type=int, default=1, show_default=True, help="Of every random choice.")

dem_input = _all(
    click.option("--cell-size", type=float, help="Side of a cell in metres; needed where the file does not say."),
    click.option("--vertical-scale", type=float, help="Metres per grey level, for 16-bit PNG."),
    click.option(
        "--rescale",
        type=float,
        help="Take the terrain as self-similar: make cells this many metres, heights by the same factor.",
    ),  # fmt: skip
)
"""How a DEM is read: `cell_size`, `vertical_scale`, `rescale`."""

traversability = _all(
    click.option("--slope-limit", type=float, default=30.0, show_default=True, help="φ_s, degrees."),
    click.option("--roughness-limit", type=float, default=0.6, show_default=True, help="r_s, metres."),
    click.option("--step-limit", type=float, default=0.2, show_default=True, help="H_s, metres."),
    click.option("--hard-slope", type=float, help="Cells steeper than this many degrees are impassable."),
    click.option("--hard-roughness", type=float, help="Cells rougher than this many metres are impassable."),
    click.option("--hard-step", type=float, help="Cells with a larger step, in metres, are impassable."),
)
"""Eq. 1's limits, as the arguments of `make_traversability`."""


def make_traversability(
    slope_limit: float, roughness_limit: float, step_limit: float,
    hard_slope: float | None, hard_roughness: float | None, hard_step: float | None,
) -> Any:  # fmt: skip
    """The `Traversability` that the options describe."""
    from math import inf

    from nnpp_edge.runtime.terrain.traversability import Traversability

    return Traversability(
        slope_limit_deg=slope_limit, roughness_limit_m=roughness_limit, step_limit_m=step_limit,
        hard_slope_deg=inf if hard_slope is None else hard_slope,
        hard_roughness_m=inf if hard_roughness is None else hard_roughness,
        hard_step_m=inf if hard_step is None else hard_step,
    )  # fmt: skip


def load_dem(path: Path, cell_size: float | None, vertical_scale: float | None, rescale: float | None) -> Any:
    """Read a DEM as the options of `dem_input` say."""
    from nnpp_edge.terrain.dem import read_dem

    dem = read_dem(path, cell_size_m=cell_size, vertical_scale=vertical_scale)
    return dem if rescale is None else dem.rescaled(rescale)
