"""A network for one's own terrain: from one elevation map to an int8 model that plans on it.

One map is enough. A stripe at its end is kept out of the training and judges what was learned. The steps are those of `nnpp-edge
dataset`, `train`, `export` and `quantize`. Minutes of training show how it goes, not what it is worth; whether a network is worth
having at all is another question (docs/when-not-to-use-the-network.md). Needs the extra `train`.

Run time: 3 min; 20 s with --small.
Data: earth_hummocks, airborne lidar with cells of 1 m, MIT licence (nnpp_edge/terrain/samples/README.md).
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
from nnpp_edge.terrain.shards import Recipe
from nnpp_edge.terrain.shipped import sample_dem, sample_path
from nnpp_edge.terrain.workloads import workload
from nnpp_edge.training.checkpoint import load_checkpoint
from nnpp_edge.training.train import TrainSettings, train


def main(folder: Path, small: bool = False) -> Path:
    """Make the data, train, export, quantise, and plan with what came out."""
    work = folder / ("own-small" if small else "own")
    recipe = Recipe(
        (str(sample_path("earth_hummocks")),),
        size=64,
        blocks=16,
        maps=24 if small else 512,
        maps_per_shard=24 if small else 64,
        cell_sizes_m=(),
        poolings=((1, 1.0),),
        synthetic_share=0.0,
        workloads=(("limit20", 1.0),),
        stripe=(0.0, 0.7),
    )
    make_dataset(recipe, work / "train", workers=1)
    apart = structs.replace(recipe, stripe=(0.7, 1.0), maps=8 if small else 64, maps_per_shard=8 if small else 64)
    make_dataset(apart, work / "held-out", workers=1)
    settings = TrainSettings(batch=16, steps=8 if small else 1500, warmup_steps=2 if small else 100)
    learned, held_out = read_samples(work / "train"), read_samples(work / "held-out")
    spec = replace(PRESETS["edge"], input_size=64)
    checkpoint = load_checkpoint(train(spec, settings, learned, held_out, work / "run", omega=recipe.omega))
    export_network(checkpoint.trained(), work / "own-fp32.onnx", name="own", limits=recipe.common_limits)
    report = quantize(
        work / "own-fp32.onnx",
        work / "train",
        work / "own.onnx",
        validation=work / "held-out",
        samples=16 if small else 200,
        rounds=5,
    )
    print(report.recommendation)

    dem, start, goal = sample_dem("earth_hummocks"), (20, 20), (240, 150)
    figure, axes = panels(2)
    for panel, model in zip(axes, ("edge", work / "own.onnx"), strict=True):
        planner = Planner.of_elevation(dem.elevation, 1.0, workload("limit20"), model=model, warn=False)
        plan = planner.plan(start, goal, method="nnpp", keep_regions=True)
        name = getattr(model, "name", "the shipped edge")
        gap = plan.cost / planner.plan(start, goal, method="astar").cost - 1
        relief(panel, dem, f"{name}: +{100 * gap:.2f} %, {plan.expansions} cells expanded")
        if plan.region is not None:
            panel.contour(plan.region.mask(), levels=[0.5], colors="cyan", linewidths=1)
        line(panel, plan.path)
        ends(panel, start, goal)
    return save(figure, folder, "own_terrain_to_int8")


if __name__ == "__main__":
    run(main)
