"""The files that `nnpp-edge plan` writes: path, picture and figures, and the profile."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli.options import PATH, gathered, together

if TYPE_CHECKING:
    from nnpp_edge.cli.plan_answer import Answer
    from nnpp_edge.runtime.cells import Cell

FORMATS = ("gpkg", "gpx")
"""Of the path, beside GeoJSON and CSV."""
_PROFILE = "profile.png"


@dataclass(frozen=True)
class Outputs:
    """Where the answer goes: the options' values, as given."""

    output: Path | None
    formats: tuple[str, ...]
    profile_plot: str | None

    def __post_init__(self) -> None:
        """Refuse what has no folder to go to, or an unknown picture."""
        if self.formats and self.output is None:
            raise click.UsageError("--format is of what is written: give -o too")
        if self.profile_plot is None:
            return
        from nnpp_edge.runtime.errors import optional_module
        from nnpp_edge.viz.profile_picture import ENDINGS

        if self.profile_plot == _PROFILE and self.output is None:
            raise click.UsageError("--profile-plot needs a file's name, or -o for its folder")
        if (ending := Path(self.profile_plot).suffix.lower()) not in ENDINGS:
            raise click.UsageError(
                f"--profile-plot must end with {', '.join(ENDINGS)}, got {ending or 'no ending'!r}"
            )
        optional_module("matplotlib", "--profile-plot", "viz")

    @property
    def paths(self) -> list[tuple[str, Path]]:
        """The files, each with the option that asks for it."""
        names = ["path.geojson", "path.csv", "plan.png", "plan.json", *(f"path.{name}" for name in self.formats)]
        found = [("--output", self.output / name) for name in names] if self.output else []
        if self.profile_plot is not None:
            beside = self.output is not None and self.profile_plot == _PROFILE
            folder = self.output if beside and self.output else Path()
            found.append(("--profile-plot", folder / self.profile_plot))
        return found

    def save(self, answer: Answer) -> list[str]:
        """Write all of them, or none; their names."""
        from nnpp_edge.files import write_all

        paths = [path for _, path in self.paths]
        files = [str(path) for path in paths]
        write_all({path: _content(path, answer, files) for path in paths})
        return files


def _content(path: Path, answer: Answer, files: list[str]) -> bytes:
    """The content of a file, by its name."""
    route, stops = answer.route, answer.tour.stops[1:-1] if answer.tour else ()
    makers: dict[str, Callable[[], bytes]] = {
        "path.geojson": lambda: route.geojson(answer.properties()),
        "path.csv": route.csv,
        "plan.json": lambda: json.dumps(answer.figures(files), indent=1).encode(),
        "plan.png": lambda: _picture(answer, stops),
        "path.gpkg": lambda: route.geopackage(answer.properties()),
        "path.gpx": lambda: route.gpx(
            "nnpp-edge plan",
            {"start": answer.start, **{f"via {at}": stop for at, stop in enumerate(stops, 1)}, "goal": answer.goal},
        ),
    }
    if path.name in makers:
        return makers[path.name]()
    from nnpp_edge.runtime.map.along import crossings
    from nnpp_edge.viz.profile_picture import profile_picture

    legs = [len(crossings(leg.line)) - 1 for leg in (answer.tour.legs if answer.tour and answer.plan.ok else ())]
    between = [sum(legs[:at]) for at in range(1, len(legs))]
    return profile_picture(path, route.along, route.cost, "\n".join(answer.on_the_ground().values()), between)


def _picture(answer: Answer, stops: tuple[Cell, ...]) -> bytes:
    """The plan on the cost map, or on one whose cells are `factor` times as large."""
    from nnpp_edge.viz.picture import BodyDrawing, body_outlines, plan_picture, png_bytes

    dem, plan, factor, vehicle = answer.route.dem, answer.plan, answer.factor, answer.vehicle
    start, goal, *between = [(row // factor, col // factor) for row, col in (answer.start, answer.goal, *stops)]
    body = {}
    if vehicle is not None:
        outlines = body_outlines(plan.path, vehicle, (dem.cell_size_m, dem.cell_width_m))
        body["body"] = BodyDrawing(outlines, answer.stands, answer.point_path)
    picture = plan_picture(
        answer.cost,
        plan if factor == 1 else replace(plan, path=plan.path // factor),
        start=start,
        goal=goal,
        via=between,
        shade=answer.shade,
        reference_path=answer.exact_path,
        cell_size_m=dem.cell_width_m * factor,
        length_m=answer.route.length_m,
        **body,
    )
    return png_bytes(picture)


outputs = together(
    click.option("-o", "--output", type=PATH, help="Folder for path.geojson, path.csv, plan.png and plan.json."),
    click.option(
        "--format",
        "formats",
        type=click.Choice(FORMATS),
        multiple=True,
        help="Write the path there as GeoPackage or GPX too, path.gpkg or path.gpx.",
    ),
    click.option(
        "--profile-plot",
        is_flag=False,
        flag_value=_PROFILE,
        metavar="[FILE]",
        help="Draw height, slope and cost along the path: .png, .svg or .pdf; profile.png in the folder of -o.",
    ),
    gathered("outputs", Outputs),
)
"""What is written; the command is given it as `outputs`."""
