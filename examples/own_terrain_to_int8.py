"""A network for one's own terrain: from one elevation map to an int8 model that plans on it.

One map is enough; a stripe at its end judges what was learned. The steps are those of `nnpp-edge dataset`, `train`,
`export` and `quantize`. Minutes of training show how it goes, not what it is worth; whether a network is worth having
at all is told in docs/when-not-to-use-the-network.md. Needs the extra `train`.

Run time: 3 min; 20 s with --small.
Data: earth_hummocks, airborne lidar, MIT licence (nnpp_edge/terrain/samples/README.md).
"""

from dataclasses import replace
from pathlib import Path

from drawing import ends, line, panels, relief, run, save
from msgspec import structs

from nnpp_edge.calibrate.quantize import quantize
from nnpp_edge.export.to_onnx import export_network
from nnpp_edge.model.registry import PRESETS
from nnpp_edge.runtime import Planner
from nnpp_edge.terrain.dataset import make_dataset, read_samples
from nnpp_edge.terrain.dem import sample_dem, sample_path
from nnpp_edge.terrain.shards import Recipe
from nnpp_edge.terrain.workloads import workload
from nnpp_edge.training.checkpoint import TrainSettings, load_checkpoint
from nnpp_edge.training.train import train

RULE = {"workloads": (("limit20", 1.0),), "cell_sizes_m": (), "poolings": ((1, 1.0),), "synthetic_share": 0.0}


def main(folder: Path, small: bool = False) -> Path:
    """Make the data, train, export, quantise, and plan with what came out."""
    maps, apart, steps, queries = (24, 8, 8, 16) if small else (512, 64, 1500, 200)
    work, start, goal = folder / f"own-{maps}", (20, 20), (240, 150)
    recipe = Recipe((str(sample_path("earth_hummocks")),), maps=maps, size=64, blocks=16, stripe=(0.0, 0.7), **RULE)
    make_dataset(recipe, work / "train", workers=1)
    make_dataset(structs.replace(recipe, maps=apart, stripe=(0.7, 1.0)), work / "apart", workers=1)

    sets = [read_samples(work / name) for name in ("train", "apart")]
    settings = TrainSettings(batch=16, steps=steps, warmup_steps=steps // 8)
    checkpoint = train(replace(PRESETS["edge"], input_size=64), settings, *sets, work / "run", omega=recipe.omega)
    export_network(load_checkpoint(checkpoint).trained(), work / "fp32.onnx", name="own", limits=recipe.common_limits)
    report = quantize(work / "fp32.onnx", work / "train", work / "own.onnx", samples=queries, rounds=5)
    print(report.recommendation)

    dem, (figure, axes) = sample_dem("earth_hummocks"), panels(2)
    for panel, (name, model) in zip(axes, {"shipped": "edge", "own": work / "own.onnx"}.items(), strict=True):
        planner = Planner.of_elevation(dem.elevation, dem.cell_size_m, workload("limit20"), model=model, warn=False)
        plan = planner.plan(start, goal, method="nnpp", keep_regions=True)
        gap = plan.cost / planner.plan(start, goal, method="astar").cost - 1
        relief(panel, dem, f"{name} network's region:\n+{100 * gap:.2f} %, {plan.expansions} cells expanded")
        panel.contour(plan.region.mask(), levels=[0.5], colors="cyan", linewidths=1)
        line(panel, plan.path)
        ends(panel, start, goal)
    return save(figure, folder, "own_terrain_to_int8")


if __name__ == "__main__":
    run(main)
