"""The files that `nnpp-edge plan` writes: path, picture and figures, and the profile."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli.options import PATH, gathered, together

if TYPE_CHECKING:
    from nnpp_edge.cli.plan_answer import Answer, Planned
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.viz.picture import BodyDrawing

FORMATS = ("gpkg", "gpx")
"""Of the path, beside GeoJSON and CSV."""
_PROFILE = "profile.png"


@dataclass(frozen=True)
class Outputs:
    """Where the answer goes. The options' values, as given."""

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
            alone = self.profile_plot == _PROFILE and self.output is not None
            path = self.output / _PROFILE if alone and self.output else Path(self.profile_plot)
            found.append(("--profile-plot", path))
        return found

    def save(self, planned: Planned) -> list[str]:
        """Write all of them, or none; their names."""
        from nnpp_edge.files import write_all

        paths = [path for _, path in self.paths]
        files = [str(path) for path in paths]
        figures = planned.answer.figures(files)
        write_all({path: _content(path, planned, figures) for path in paths})
        return files


def _content(path: Path, planned: Planned, figures: dict[str, object]) -> bytes:
    """What goes into a file, by its name."""
    answer = planned.answer
    route, tour = answer.route, answer.tour
    if path.name == "path.geojson":
        return route.geojson(answer.properties())
    if path.name == "path.csv":
        return route.csv()
    if path.name == "plan.json":
        return json.dumps(figures, indent=1).encode()
    if path.name == "path.gpkg":
        return route.geopackage(answer.properties())
    if path.name == "path.gpx":
        between = {f"via {at}": stop for at, stop in enumerate(tour.stops[1:-1] if tour else (), 1)}
        return route.gpx("nnpp-edge plan", {"start": answer.start, **between, "goal": answer.goal})
    if path.name == "plan.png":
        return _picture(planned)
    from nnpp_edge.runtime.map.along import crossings
    from nnpp_edge.viz.profile_picture import profile_picture

    legs = [len(crossings(leg.line)) - 1 for leg in (tour.legs if tour and answer.plan.ok else ())]
    stops = [sum(legs[:at]) for at in range(1, len(legs))]
    return profile_picture(path, route.along, route.cost, "\n".join(answer.on_the_ground().values()), stops)


def _picture(planned: Planned) -> bytes:
    """The plan on the cost map, or on one whose cells are `factor` times as large."""
    from nnpp_edge.viz.picture import plan_picture, png_bytes

    answer, factor = planned.answer, planned.factor
    dem, plan = answer.route.dem, answer.plan
    stops: tuple[Cell, ...] = answer.tour.stops if answer.tour else ()
    start, goal, *between = [(row // factor, col // factor) for row, col in (answer.start, answer.goal, *stops[1:-1])]
    picture = plan_picture(
        planned.cost,
        plan if factor == 1 else replace(plan, path=plan.path // factor),
        start=start,
        goal=goal,
        via=between,
        shade=planned.shade,
        reference_path=answer.exact_path,
        cell_size_m=dem.cell_width_m * factor,
        length_m=answer.route.length_m,
        **({} if answer.vehicle is None else {"body": _body(answer)}),
    )
    return png_bytes(picture)


def _body(answer: Answer) -> BodyDrawing:
    """What the picture shows of the vehicle."""
    from nnpp_edge.viz.picture import BodyDrawing, body_outlines

    assert answer.vehicle is not None
    sides = answer.route.dem.cell_size_m, answer.route.dem.cell_width_m
    return BodyDrawing(body_outlines(answer.plan.path, answer.vehicle, sides), answer.stands, answer.point_path)


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
