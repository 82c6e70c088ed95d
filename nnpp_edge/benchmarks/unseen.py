"""Drives over ground that is known coarsely: what each rule for the price of unseen ground costs.

    python -m nnpp_edge.benchmarks.unseen TILE --factor 8 --sight 16 --drives 200 --dataset data/unseen --json

A robot knows means over factor × factor cells, sees the cells within `sight` of itself, and plans anew by exact A*
whenever it has driven half as far: over what it has seen, and by prices elsewhere. All rivals drive the same drives;
judged is the cost driven, above that of the path that is best for who knows all. Trees need scikit-learn.
"""

import argparse
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA, StepModel
from nnpp_edge.runtime.network.model_file import UNSEEN, model_path
from nnpp_edge.runtime.network.priors import CoarseCost, CoarseSlope, NetworkPrior, Prior, within
from nnpp_edge.runtime.network.unseen import Seen, encode_unseen, prices_of
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost
from nnpp_edge.runtime.tuning import MOST_PRICE
from nnpp_edge.terrain.dataset import read_known
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.terrain.workloads import workload
from nnpp_edge.training.unseen import sample

SCALE = 1.0 + MOST_PRICE
"""T is divided and ω multiplied by it, so that a planner of costs takes prices above 1."""
LEAST_APART = 0.6
"""Of the map's side, between start and goal."""
MOST_BLOCKED = 0.6
"""Windows with a greater share of impassable cells are left out."""
Price = Callable[["Ground", Seen], Float2D]


@dataclass(frozen=True, eq=False)
class Ground:
    """A map in full, and as means over its blocks."""

    elevation: Float2D
    cell_size_m: float
    limits: Traversability
    factor: int

    @cached_property
    def grid(self) -> Grid:
        """By which drives are priced."""
        cost = traversability_cost(self.elevation, self.cell_size_m, self.limits, warn=False)
        return Grid.of(cost, StepModel.of("paper", PAPER_OMEGA))

    @cached_property
    def cost(self) -> Float2D:
        """T, and inf where impassable."""
        cost: Float2D = self.grid.map() / np.float32(self.grid.model.scale)
        return cost

    @cached_property
    def coarse(self) -> Float2D:
        """The part that is known beforehand."""
        return self.pooled(self.elevation)

    def pooled(self, cells: NDArray[np.generic]) -> Float2D:
        """Means over the blocks."""
        side, k = len(cells) // self.factor, self.factor
        means: Float2D = cells.reshape(side, k, side, k).mean(axis=(1, 3), dtype=np.float32)
        return means

    def seen(self, mask: NDArray[np.bool_]) -> Seen:
        """Of each block, where these cells were seen."""
        share, impassable = self.pooled(mask), np.isinf(self.cost)
        some = np.maximum(share, np.float32(1e-9))
        mean = np.divide(self.pooled(np.where(mask, np.minimum(self.cost, 1.0), 0.0)), some, dtype=np.float32)
        return Seen(mean, np.divide(self.pooled(mask & impassable), some, dtype=np.float32), share)


@dataclass(frozen=True, eq=False)
class Drive:
    """From where to where on which ground, and what the best path costs."""

    ground: Ground
    start: Cell
    goal: Cell
    optimum: float

    def driven(self, price: Price, sight: int) -> float:
        """Cost of the drive, above the optimum as a share of it."""
        ground, (rows, cols) = self.ground, self.ground.cost.shape
        mask = np.zeros((rows, cols), np.bool_)
        truth = ground.cost / np.float32(SCALE)
        planner = Planner(truth, omega=PAPER_OMEGA * SCALE)
        at, cost = self.start, 0.0
        while at != self.goal:
            near = tuple(slice(max(place - sight, 0), place + sight + 1) for place in at)
            mask[near] = True
            prices = price(ground, ground.seen(mask)) / np.float32(SCALE)
            unseen = prices.repeat(ground.factor, axis=0).repeat(ground.factor, axis=1)
            planner.update(0, 0, np.where(mask, truth, unseen))
            path = planner.plan(at, self.goal, method="astar").path[: max(sight // 2, 1) + 1]
            cost += ground.grid.costs_of(path)[0]
            at = (int(path[-1, 0]), int(path[-1, 1]))
        return cost / self.optimum - 1.0


def drives(
    dem: Dem, limits: Traversability, factor: int, count: int, *, side: int = 256, seed: int = 1
) -> Iterator[Drive]:
    """Drives on random windows of a map, two on each."""
    rng = np.random.default_rng(seed)
    side = min(side, *dem.shape) // factor * factor
    while count > 0:
        row, col = (int(rng.integers(0, cells - side + 1)) for cells in dem.shape)
        elevation = np.ascontiguousarray(dem.elevation[row : row + side, col : col + side])
        ground = Ground(elevation, dem.cell_size_m, limits, factor)
        if np.isinf(ground.cost).mean() > MOST_BLOCKED:
            continue
        planner, found = Planner(ground.cost), 0
        for _ in range(100):
            start, goal = (tuple(map(int, rng.integers(0, side, 2))) for _ in range(2))
            if math.dist(start, goal) < LEAST_APART * side:
                continue
            plan = planner.plan((start[0], start[1]), (goal[0], goal[1]), method="astar")
            if plan.ok:
                yield Drive(ground, (start[0], start[1]), (goal[0], goal[1]), plan.cost)
                found, count = found + 1, count - 1
            if found == 2 or count == 0:
                break


def rivals(
    model: str, limits: Traversability, cell_size_m: float, factor: int, dataset: Path | None
) -> dict[str, Price]:
    """All by name: rules, the network and its controls, trees if there is a data set for them, the truth."""
    block_m = cell_size_m * factor
    network, shuffled = NetworkPrior(model, limits, block_m, factor), shuffled_network(model, limits, block_m, factor)

    def of(prior: Prior) -> Price:
        return lambda ground, seen: prior.prices(ground.coarse, seen)

    def truth(ground: Ground, seen: Seen) -> Float2D:
        known = ground.seen(np.ones(ground.cost.shape, np.bool_))
        return within(known.mean + 2.0 * known.blocked, ground.coarse)

    found: dict[str, Price] = {
        "optimistic": lambda ground, seen: np.zeros_like(ground.coarse),
        "mean": lambda ground, seen: np.full_like(ground.coarse, truth(ground, seen).mean()),
        "eq1": of(CoarseCost(limits, block_m)),
        "slope": of(CoarseSlope(limits, block_m, factor)),
        "network": of(network),
        "network, nothing seen": lambda ground, seen: network.prices(ground.coarse),
        "network, answers turned": lambda ground, seen: np.rot90(network.prices(ground.coarse, seen)),
        "network, weights shuffled": of(shuffled),
        "truth": truth,
    }
    if dataset is not None:
        found["trees"] = trees(read_known(dataset))
    return found


def shuffled_network(model: str, limits: Traversability, block_m: float, factor: int) -> NetworkPrior:
    """The network with the weights of each convolution in another order."""
    import onnx

    graph, rng = onnx.load(model_path(model)), np.random.default_rng(1)
    for tensor in graph.graph.initializer:
        if len(tensor.dims) == 4:
            values = onnx.numpy_helper.to_array(tensor)
            shuffled = rng.permutation(values.ravel()).reshape(values.shape)
            tensor.CopyFrom(onnx.numpy_helper.from_array(shuffled, tensor.name))
    with TemporaryDirectory() as folder:
        (path := Path(folder) / "shuffled.onnx").write_bytes(graph.SerializeToString())
        return NetworkPrior(path, limits, block_m, factor)


def features(planes: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H · W, F) features of blocks, from a network's planes: the block's own, and of its neighbourhood."""
    named = dict(zip(UNSEEN, planes, strict=True))
    seen, known = named["seen"], np.maximum(named["known"], np.float32(0.0))
    of_seen = [seen, *(seen * named[name] for name in ("seen_mean", "seen_blocked", "seen_more_blocked"))]
    heights = [named[name] for name in ("slope", "step", "blocked_by_slope", "above_3", "above_7", "above_15")]
    found = [*planes, np.abs(named["slope_across"]), np.abs(named["slope_down"])]
    for side in (3, 7, 15):
        kernel = np.ones((side, side), np.uint8)
        found += [cv2.blur(plane, (side, side)) for plane in (*heights, known, *(plane**2 for plane in heights[3:]))]
        weight = np.maximum(cv2.blur(seen, (side, side)), np.float32(1e-3))
        found += [cv2.blur(plane, (side, side)) / weight for plane in of_seen[1:]] + [weight]
        found += [cv2.dilate(heights[0], kernel), cv2.erode(heights[0], kernel)]
    return np.stack(found, axis=-1).reshape(-1, len(found))


def trees(maps: KnownMaps, rows: int = 600_000, iterations: int = 250) -> Price:
    """Boosted trees on features made by hand, trained on the network's data and targets."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    rng, inputs, wanted = np.random.default_rng(1), list[Any](), list[Any]()
    share = min(1.0, rows / maps.closed.size)
    for at in range(len(maps)):
        planes, answers = sample(maps, at, rng)
        chosen = np.flatnonzero(np.isfinite(answers[0]).ravel() & (rng.random(answers[0].size) < share))
        inputs.append(features(planes)[chosen])
        wanted.append(answers.reshape(len(answers), -1)[:, chosen])
    x, y = np.concatenate(inputs), np.concatenate(wanted, axis=1)
    settings = {"max_iter": iterations, "max_leaf_nodes": 63, "min_samples_leaf": 60, "early_stopping": False}
    fitted = [HistGradientBoostingRegressor(**settings).fit(x, each) for each in y]

    def price(ground: Ground, seen: Seen) -> Float2D:
        planes = np.empty((len(UNSEEN), *ground.coarse.shape), np.float32)
        encode_unseen(ground.coarse, seen, ground.limits, ground.cell_size_m * ground.factor, ground.factor, planes)
        shown = features(planes)
        answers = np.array([np.clip(each.predict(shown), 0.0, 1.0) for each in fitted], np.float32)
        return within(prices_of(answers.reshape(len(answers), *ground.coarse.shape)), ground.coarse)

    return price


def table(excess: Mapping[str, NDArray[np.float64]], reference: str = "slope") -> str:
    """Mean excess and its standard error, 90th percentile, and the paired difference to the reference, in percent."""
    lines = [f"{'price':28} {'mean':>6} {'s.e.':>5} {'p90':>6}   {'to ' + reference:>9} {'s.e.':>5} {'ratio':>6}"]
    for name, found in excess.items():
        apart, root = found - excess[reference], math.sqrt(len(found))
        figures = [100 * found.mean(), 100 * found.std() / root, 100 * np.quantile(found, 0.9)]
        paired = [100 * apart.mean(), 100 * apart.std() / root, found.mean() / excess[reference].mean()]
        lines.append("{:28} {:6.2f} {:5.2f} {:6.2f}   {:+9.2f} {:5.2f} {:6.2f}".format(name, *figures, *paired))
    return "\n".join(lines)


def main() -> None:
    """Drive, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m nnpp_edge.benchmarks.unseen", description=__doc__)
    parser.add_argument("tile", type=Path)
    for name, default in (("factor", 8), ("sight", 16), ("drives", 200), ("side", 256), ("seed", 1)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--workload", default="soft")
    parser.add_argument("--rescale", type=float, help="as of nnpp-edge plan, metres")
    parser.add_argument("--model", default="unseen")
    parser.add_argument("--dataset", type=Path, help="to train trees on")
    parser.add_argument("--only", help="names of rivals, joined by commas")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    dem = read_dem(given.tile)
    dem = dem.rescaled(given.rescale) if given.rescale else dem
    limits = workload(given.workload)
    found = rivals(given.model, limits, dem.cell_size_m, given.factor, given.dataset)
    wanted = given.only.split(",") if given.only else list(found)
    cases = list(drives(dem, limits, given.factor, given.drives, side=given.side, seed=given.seed))
    excess = {name: np.array([case.driven(found[name], given.sight) for case in cases]) for name in wanted}
    print(json.dumps({name: each.tolist() for name, each in excess.items()}) if given.json else table(excess))


if __name__ == "__main__":
    main()
