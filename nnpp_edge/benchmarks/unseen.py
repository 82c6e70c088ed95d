"""Drives over unseen ground by rival prices: ``python -m nnpp_edge.benchmarks.unseen MAP``.

A robot knows the means of blocks and sees `sight` cells to each side. It plans by exact A* after
every drive half as far, over what it has seen, and by prices elsewhere. All rivals drive the same
drives; judged is the cost driven above that of the path that is best for who knows all. Trees need
scikit-learn.
"""

import argparse
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.suites import whole_cost
from nnpp_edge.reproduction.regions import shuffled
from nnpp_edge.runtime import Ground, NetworkModel, Planner, Vehicle
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.network.model_file import UNSEEN, model_path
from nnpp_edge.runtime.network.priors import PRIORS, prices_by
from nnpp_edge.runtime.network.unseen import encode_unseen, prices_of
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain.dataset import read_known
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.known import KnownMaps, known_map
from nnpp_edge.terrain.labels import random_query
from nnpp_edge.terrain.rocks import Rocks, draw_rocks, rock_heights
from nnpp_edge.terrain.vehicle_files import load_vehicle
from nnpp_edge.terrain.workloads import workload
from nnpp_edge.training.unseen import sample

LEAST_APART = 0.6
"""Of the map's side, between start and goal."""
MOST_ROCKS = 0.12
LEAST_ROCKS = 1 / 12
PATCH_M = 12.0
"""Most of the ground under rocks, the least as a share of that, and the smoothing of the noise
between, metres.
"""
MOST_BLOCKED = 0.6
"""Windows with a greater share of impassable cells are left out."""


@dataclass(frozen=True, eq=False)
class Site:
    """A square map, of which a robot knows the means of blocks."""

    elevation: Float2D
    cell_size_m: float
    limits: Traversability
    factor: int
    vehicle: Vehicle | None = None

    @cached_property
    def whole(self) -> Planner:
        """Of who knows all."""
        return Planner.of_elevation(
            self.elevation, self.cell_size_m, self.limits, vehicle=self.vehicle, warn=False
        )

    @cached_property
    def costs(self) -> Float2D:
        """(H, W) of each cell, for a body of its best pose there."""
        return whole_cost(
            Ground.of_elevation(self.elevation, self.cell_size_m, self.limits, vehicle=self.vehicle)
        )

    @cached_property
    def coarse(self) -> Float2D:
        """The part that is known beforehand."""
        side = len(self.elevation) // self.factor
        k = self.factor
        means: Float2D = (
            self.elevation.reshape(side, k, side, k)
            .mean((1, 3), dtype=np.float64)
            .astype(np.float32)
        )
        return means

    def prices(self, prior: str, model: str | NetworkModel = "unseen") -> Float2D:
        """By one of `PRIORS`."""
        return prices_by(
            prior, self.coarse, self.limits, self.cell_size_m * self.factor, self.factor, model
        )

    def truth(self) -> Float2D:
        """The prices by what the blocks' cells turn out to be."""
        of_map = known_map(self.elevation, self.costs, self.cell_size_m, self.limits, self.factor)
        return prices_of(KnownMaps(*(np.array([each]) for each in of_map)).wanted(0))

    def driven(self, ends: Endpoints, prices: Float2D, sight: int) -> float:
        """Cost of a drive from start to goal by these prices."""
        place = self.coarse, self.cell_size_m * self.factor, self.factor, self.limits
        planner = Planner.of_coarse(*place, prior="mean", vehicle=self.vehicle, warn=False)
        assert planner.state.unseen is not None
        planner.state.unseen.layers[0] = prices
        way = [ends[0]]
        far = sight + planner.state.reach_cells
        heading = None
        while way[-1] != ends[1]:
            row, col = (max(place - far, 0) for place in way[-1])
            planner.update_elevation(
                row, col, self.elevation[row : way[-1][0] + far + 1, col : way[-1][1] + far + 1]
            )
            if self.vehicle is None:
                plan = planner.plan(way[-1], ends[1], method="astar")
            else:
                plan = planner.plan(way[-1], ends[1], method="corridor", start_heading_deg=heading)
            if not plan.ok:
                assert self.vehicle is not None, "what was seen shuts the way, though there is one"
                return math.inf  # the body can neither go on nor turn
            driven = min(max(sight // 2, 1), len(plan.path) - 1)
            way += [(row, col) for row, col in plan.path[1 : driven + 1].tolist()]
            heading = float(plan.headings_deg[driven - 1])
        return self.whole.state.grid.costs_of(np.array(way, np.int32))[0]


Price = Callable[[Site], Float2D]


def drives(
    dem: Dem,
    limits: Traversability,
    factor: int,
    count: int,
    *,
    side: int = 256,
    seed: int = 1,
    vehicle: Vehicle | None = None,
) -> Iterator[tuple[Site, Endpoints, float]]:
    """Drives on random windows of a map, at most two on each, and what the best path costs.

    A vehicle drives among rocks on 1 to 12 % of the ground, more and fewer by the dozen of metres.
    """
    rng = np.random.default_rng(seed)
    side = min(side, *dem.shape) // factor * factor
    while count > 0:
        row, col = (int(rng.integers(0, cells - side + 1)) for cells in dem.shape)
        elevation = np.ascontiguousarray(dem.elevation[row : row + side, col : col + side])
        if vehicle is not None:
            elevation = elevation + patchy_rocks(elevation.shape, dem.cell_size_m, rng)
        site = Site(elevation, dem.cell_size_m, limits, factor, vehicle)
        for _ in range(min(count, 2) if np.isinf(site.costs).mean() <= MOST_BLOCKED else 0):
            if (ends := random_query(rng, site.costs, LEAST_APART * side)) is None:
                continue
            if (plan := site.whole.plan(*ends, method="astar")).ok:
                yield site, ends, plan.cost
                count -= 1


def patchy_rocks(shape: tuple[int, int], side_m: float, rng: np.random.Generator) -> Float2D:
    """(H, W) metres by which rocks raise the cells of a map: as `draw_rocks` has them, in some
    places fewer.
    """
    noise = cv2.GaussianBlur(rng.normal(size=shape), (0, 0), PATCH_M / side_m)
    kept = (
        LEAST_ROCKS
        + (1.0 - LEAST_ROCKS) * noise.ravel().argsort().argsort().reshape(shape) / noise.size
    )
    rocks = draw_rocks(shape, (side_m, side_m), MOST_ROCKS, rng, (0.2, 3.0))
    there = rng.random(len(rocks.places)) < kept[tuple(np.rint(rocks.places).astype(int).T)]
    return rock_heights(shape, (side_m, side_m), Rocks(*(each[there] for each in rocks)))


def rivals(model: str, dataset: Path | None) -> dict[str, Price]:
    """All by name: the priors, the network's controls, the truth, trees if there is a data set for
    them.
    """
    found: dict[str, Price] = {
        "optimistic": lambda site: np.zeros_like(site.coarse),
        **{prior: partial(Site.prices, prior=prior, model=model) for prior in PRIORS},
        "network, answers turned": lambda site: np.rot90(site.prices("network", model)),
        "network, weights shuffled": lambda site: site.prices(
            "network", shuffled(model_path(model))
        ),
        "truth": Site.truth,
    }
    return found if dataset is None else found | {"trees": trees(read_known(dataset))}


def features(planes: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H · W, F) features of blocks, from a network's planes: the block's own, and of its
    neighbourhood.
    """
    named = dict(zip(UNSEEN, planes, strict=True))
    names = ("slope", "step", "blocked_by_slope", "above_3", "above_7", "above_15")
    heights = [named[name] for name in names]
    found = [*planes, np.abs(named["slope_across"]), np.abs(named["slope_down"])]
    for side in (3, 7, 15):
        kernel = np.ones((side, side), np.uint8)
        blurred = *heights, named["known"], *(plane**2 for plane in heights[3:])
        found += [cv2.blur(plane, (side, side)) for plane in blurred]
        found += [cv2.dilate(heights[0], kernel), cv2.erode(heights[0], kernel)]
    return np.stack(found, axis=-1).reshape(-1, len(found))


def trees(maps: KnownMaps, rows: int = 600_000, iterations: int = 250) -> Price:
    """Boosted trees on features made by hand, trained on the network's data and targets."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    rng = np.random.default_rng(1)
    share = min(1.0, rows / maps.answers[:, 0].size)
    inputs = list[NDArray[np.float32]]()
    wanted = list[NDArray[np.float32]]()
    for at in range(len(maps)):
        planes, answers = sample(maps, at)
        chosen = rng.random(answers[0].size) < share
        inputs.append(features(planes)[chosen])
        wanted.append(answers.reshape(len(answers), -1)[:, chosen])
    x = np.concatenate(inputs)
    y = np.concatenate(wanted, axis=1)
    settings = {
        "max_iter": iterations,
        "max_leaf_nodes": 63,
        "min_samples_leaf": 60,
        "early_stopping": False,
    }
    fitted = [HistGradientBoostingRegressor(**settings).fit(x, each) for each in y]

    def price(site: Site) -> Float2D:
        planes = np.empty((len(UNSEEN), *site.coarse.shape), np.float32)
        side_m = site.cell_size_m * site.factor
        encode_unseen(site.coarse, site.limits, (side_m, side_m), site.factor, planes)
        answers = np.array(
            [np.clip(each.predict(features(planes)), 0.0, 1.0) for each in fitted], np.float32
        )
        return prices_of(answers.reshape(len(answers), *site.coarse.shape))

    return price


def table(excess: Mapping[str, NDArray[np.float64]], reference: str = "slope") -> str:
    """Mean excess and its standard error, 90th percentile, and the paired difference to the
    reference, in percent.

    Of the drives on which nobody was stuck; and how often each was.
    """
    lines = [
        f"{'price':28} {'mean':>6} {'s.e.':>5} {'p90':>6}   {'to ' + reference:>9} {'s.e.':>5} "
        f"{'ratio':>6}  stuck"
    ]
    free = np.isfinite(list(excess.values())).all(axis=0)
    base = excess[reference][free]
    root = math.sqrt(free.sum())
    for name, found in ((name, each[free]) for name, each in excess.items()):
        apart = found - base
        stuck = np.isinf(excess[name]).sum()
        figures = [100 * found.mean(), 100 * found.std() / root, 100 * np.quantile(found, 0.9)]
        paired = [100 * apart.mean(), 100 * apart.std() / root, found.mean() / base.mean()]
        lines.append(
            "{:28} {:6.2f} {:5.2f} {:6.2f}   {:+9.2f} {:5.2f} {:6.2f} {:6}".format(
                name, *figures, *paired, stuck
            )
        )
    return "\n".join(lines)


def main() -> None:
    """Drive, and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m nnpp_edge.benchmarks.unseen", description=__doc__
    )
    parser.add_argument("tile", type=Path)
    for name, default in (
        ("factor", 8),
        ("sight", 16),
        ("drives", 200),
        ("side", 256),
        ("seed", 1),
    ):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--workload", default="soft")
    parser.add_argument(
        "--rescale", type=float, help="as of nnpp-edge plan; a vehicle has a quarter of its length"
    )
    parser.add_argument("--vehicle", help="whose body drives among rocks, as of nnpp-edge plan")
    parser.add_argument("--model", default="unseen")
    parser.add_argument("--dataset", type=Path, help="to train trees on")
    parser.add_argument("--only", help="names of rivals, joined by slashes, the slope among them")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    dem = read_dem(given.tile)
    vehicle = load_vehicle(given.vehicle) if given.vehicle else None
    if size_m := given.rescale or (vehicle and vehicle.length_m / 4):
        dem = dem.rescaled(size_m)
    found = rivals(given.model, given.dataset)
    wanted = given.only.split("/") if given.only else list(found)
    excess: dict[str, list[float]] = {name: [] for name in wanted}
    maps = dem, workload(given.workload), given.factor, given.drives
    for site, ends, optimum in drives(*maps, side=given.side, seed=given.seed, vehicle=vehicle):
        for name in wanted:
            excess[name].append(site.driven(ends, found[name](site), given.sight) / optimum - 1.0)
    print(
        json.dumps(excess)
        if given.json
        else table({name: np.array(each) for name, each in excess.items()})
    )


if __name__ == "__main__":
    main()
