"""Drives over unseen ground by rival prices: ``python -m nnpp_edge.benchmarks.unseen MAP``."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import click
import numpy as np

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.profiling.suites import heights_of, solvable, terrain_cases, whole_cost
from nnpp_edge.progress import bar, markdown_table
from nnpp_edge.reproduction.regions import shuffled
from nnpp_edge.runtime import Ground, NetworkModel, Planner
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints, slices, widened
from nnpp_edge.runtime.network.model_file import model_path
from nnpp_edge.runtime.network.priors import prices_by
from nnpp_edge.runtime.network.unseen import prices_of
from nnpp_edge.runtime.options import PRIORS, PlanOptions
from nnpp_edge.runtime.terrain.traversability import traversability_cost
from nnpp_edge.runtime.tuning import BLOCKED_PRICE
from nnpp_edge.terrain.dem import read_dem
from nnpp_edge.terrain.known import KnownMaps, known_map
from nnpp_edge.terrain.vehicle_files import load_vehicle

SIDE = 256
"""Cells of a map's side, where the ground is large enough."""
LEAST_APART = 0.6
"""Of the map's side, between start and goal."""
DRIVES_OF_A_MAP = 2
REFERENCE = "slope"
"""The price that the others are compared with."""


@dataclass(frozen=True, eq=False)
class BlockGround:
    """A square ground of elevations, of which a robot knows the means of blocks."""

    ground: Ground
    factor: int

    @cached_property
    def elevation(self) -> Float2D:
        return heights_of(self.ground)

    @cached_property
    def whole(self) -> Planner:
        """A planner that knows the whole map."""
        return Planner(self.ground)

    @cached_property
    def costs(self) -> Float2D:
        """(H, W) of each cell, for a body of its best pose there."""
        return whole_cost(self.ground)

    @cached_property
    def coarse(self) -> Float2D:
        """The means of the blocks."""
        return heights_of(self.ground.by_blocks(self.factor))

    @property
    def block_m(self) -> float:
        """Side of a block."""
        return self.ground.sides_m[0] * self.factor

    def prices(self, prior: str, model: str | NetworkModel = "unseen") -> Float2D:
        """By one of `PRIORS`."""
        limits = self.ground.limits
        return prices_by(prior, self.coarse, limits, self.block_m, self.factor, model)

    def by_eq1(self) -> Float2D:
        """A control: NNPP's Eq. 1 of the coarse map, as if its blocks were cells."""
        cost = traversability_cost(self.coarse, self.block_m, self.ground.limits, warn=False)
        return np.where(cost < 1.0, cost, np.float32(BLOCKED_PRICE))

    def truth(self) -> Float2D:
        """The prices by what the blocks' cells turn out to be."""
        cell_m, _ = self.ground.sides_m
        limits = self.ground.limits
        known = known_map(self.elevation, self.costs, cell_m, limits, self.factor)
        maps = KnownMaps(*(np.array([each]) for each in known))
        return prices_of(maps.wanted[0])

    def driven(self, ends: Endpoints, prices: Float2D, sight: int) -> float:
        """Cost of a drive from start to goal by these prices; inf where a body gets stuck."""
        body = self.ground.vehicle
        planner = Planner(self.ground.by_blocks(self.factor, "slope"))
        assert planner.state.unseen is not None
        planner.state.unseen.layers[0] = prices
        far = sight + planner.state.reach_cells
        here, goal = ends
        way = [here]
        options: PlanOptions = {"method": "corridor" if body else "astar"}
        while here != goal:
            # see the ground around
            part = widened((*here, 1, 1), (far, far), self.elevation.shape)
            planner.update_elevation(*part[:2], self.elevation[slices(part)])
            plan = planner.plan(here, goal, **options)
            if not plan.ok:
                assert body, "what was seen shuts the way, though there is one"
                return np.inf  # the body can neither go on nor turn
            # drive half as far as was seen
            steps = min(max(sight // 2, 1), len(plan.path) - 1)
            way += [(row, col) for row, col in plan.path[1 : steps + 1].tolist()]
            here = way[-1]
            if body:
                options["start_heading_deg"] = float(plan.headings_deg[steps - 1])
        return self.whole.state.grid.costs_of(np.array(way, np.int32))[0]


Price = Callable[[BlockGround], Float2D]


def rivals(model: str) -> dict[str, Price]:
    """All by name: the priors, the network's controls, and the truth."""
    mixed = shuffled(model_path(model))
    return {
        "optimistic": lambda site: np.zeros_like(site.coarse),
        **{prior: partial(BlockGround.prices, prior=prior, model=model) for prior in PRIORS},
        "eq1": BlockGround.by_eq1,
        "mean": lambda site: np.full_like(site.coarse, site.prices("slope").mean()),
        "network, answers turned": lambda site: np.rot90(site.prices("network", model)),
        "network, weights shuffled": lambda site: site.prices("network", mixed),
        "truth": BlockGround.truth,
    }


def table(driven: Rows) -> str:
    """Mean excess, the paired difference to the reference and its standard error, in percent.

    Of the drives on which no rival got stuck; and how often each did.
    """
    heads = ("price", "mean", f"to {REFERENCE}", "s.e.", "ratio", "stuck")
    form = "{} | {:.2f} | {:+.2f} | {:.2f} | {:.2f} | {}"
    stuck = {drive for drive, rows in driven.by("drive").items() if np.inf in rows.all("excess")}
    free = Rows(row for row in driven if row["drive"] not in stuck)
    base = 100.0 * np.array(free.of(REFERENCE).all("excess"))
    lines = []
    for name, rows in driven.by("planner").items():
        found = 100.0 * np.array(free.of(name).all("excess"))
        apart = found - base
        line = form.format(
            name,
            found.mean(),
            apart.mean(),
            apart.std() / np.sqrt(len(apart)),
            found.mean() / base.mean(),
            rows.all("excess").count(np.inf),
        )
        lines.append(line.split(" | "))
    return markdown_table(heads, lines)


@click.command(context_settings={"show_default": True})
@click.argument("tile", type=click.Path(path_type=Path))
@click.option("--factor", default=8, help="Cells to a block's side.")
@click.option("--sight", default=16, help="Cells seen to each side.")
@click.option("--drives", "count", default=200, help="Number of drives.")
@click.option("--workload", "name", default="soft", help="With --vehicle body or body-rocksN.")
@click.option(
    "--rescale", type=float, help="As of nnpp-edge plan; a vehicle has a quarter of its length."
)
@click.option("--vehicle", help="Whose body drives, as of nnpp-edge plan.")
@click.option("--model", default="unseen")
def main(
    tile: Path,
    factor: int,
    sight: int,
    count: int,
    name: str,
    rescale: float | None,
    vehicle: str | None,
    model: str,
) -> None:
    """Drive over TILE by rival prices of unseen ground, and print the excess of each.

    A robot knows the means of blocks and sees so many cells to each side. Whenever it has driven
    half as far it plans anew by exact A*, over the cells that it has seen, and by prices elsewhere.
    All rivals drive the same drives; the excess is that of the driven cost over the optimum of the
    whole map.
    """
    dem = read_dem(tile)
    body = load_vehicle(vehicle) if vehicle else None
    size_m = rescale or (body and body.length_m / 4)
    if size_m:
        dem = dem.rescaled(size_m)
    prices = rivals(model)
    rows = Rows()
    done = 0
    side = min(SIDE, *dem.shape) // factor * factor
    cases = terrain_cases([dem], name, side, 1, LEAST_APART, body)
    with bar("drives", count) as advance:
        for case in solvable(cases, count, DRIVES_OF_A_MAP):
            site = BlockGround(case.ground, factor)
            for ends in case.queries:
                done += 1
                optimum = site.whole.plan(*ends, method="astar").cost
                for rival, price in prices.items():
                    cost = site.driven(ends, price(site), sight)
                    rows.append({"drive": done, "planner": rival, "excess": cost / optimum - 1.0})
                advance(done)
    click.echo(table(rows))


if __name__ == "__main__":
    main()
