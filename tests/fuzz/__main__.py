"""Look for what the oracles refuse, for so many minutes; or do one case again."""

import itertools
import math
import os
import random
import shutil
import sys
import time
import traceback
import warnings
from collections import Counter
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path

import click

from tests.fuzz import layers, options, projections, samples, sequences
from tests.fuzz.cases import Place, kind_of
from tests.fuzz.children import ROOMY, Limits, run_forked
from tests.worlds import WORLDS

FOLDER = Path("build/fuzz")
BATCH = 200
BATCH_S = 5.0
"""Cases that one forked process does one after another, and seconds after which it begins none."""
TARGETS = {
    "options": (options.check, 15, 20),
    "layers": (layers.check, 6, 80),
    "sequences": (partial(sequences.check, worlds=[sequences.OddCosts]), 7, 200),
    "elevations": (partial(sequences.check, worlds=[WORLDS["heights"]]), 3, 150),
    "bodies": (sequences.check_bodies, 3, 8),
    "robots": (partial(sequences.check, worlds=[*WORLDS.values()]), 3, 60),
    "projections": (projections.check, 1, 60),
}
"""By name: what does a case, its share of the batches, and how many cases a short run has."""
LOADED = [
    "cv2",
    "matplotlib.font_manager",
    "onnx",
    "onnxruntime",
    "rasterio",
    "nnpp_edge.viz.picture",
]
LOADED_TO_TRAIN = ["torch", "nnpp_edge.export.to_onnx", "nnpp_edge.training.train"]


def do_case(target, seed, place):
    """Do the case of a seed, which decides all of it."""
    place.folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        TARGETS[target][0](random.Random(f"{target} {seed}"), place)


def prepare(*, trained):
    """Make the samples where they are not there yet, and load all that cases need. Leaves no thread
    behind.
    """
    os.environ["OMP_NUM_THREADS"] = "1"
    for name in (*LOADED, *LOADED_TO_TRAIN * trained):
        import_module(name)
    import cv2
    import matplotlib
    import onnxruntime

    from nnpp_edge.runtime.exercises import exercise

    matplotlib.use("Agg")
    cv2.setNumThreads(1)
    onnxruntime.set_default_logger_severity(2)
    for name in options.BASES:
        options.command_of(name)
    exercise()
    folder = FOLDER.resolve()
    place = Place(folder / "samples", folder / f"case-{os.getpid()}" / "here")
    for make in (samples.make_light, *[samples.make_trained] * trained):
        made = place.samples / make.__name__
        if not made.exists():
            ended = run_forked(partial(make, place.samples), ROOMY)
            assert ended.code == 0, ended.err
            made.write_text("")
    return place


def run_batch(target, seeds, most_s, place):
    """How many cases were done, and what was found, by the seed.

    They are done in one forked process; a case that hangs, crashes or takes too much memory ends
    it.
    """
    until = time.monotonic() + most_s

    def batch():
        for seed in seeds:
            print(f"\0{seed}", flush=True)
            try:
                do_case(target, seed, place)
            except Exception as error:
                told = f"{kind_of(error)}\n{traceback.format_exc()}"
                print(told[:20_000].replace("\0", "␀"), flush=True)
            if time.monotonic() > until:
                break

    by_itself = target == "options"  # its cases are watched one by one
    limits = Limits(900.0, 900, 64 << 30) if by_itself else Limits(120.0, 100, 1 << 30)
    ended = run_forked(batch, limits)
    told = [each.partition("\n") for each in ended.out.split("\0")[1:]]
    found = {int(seed): text.strip() for seed, _, text in told if text.strip()}
    if ended.code:
        kind = "hangs" if ended.late else f"killed by signal {-ended.code}"
        found[int(told[-1][0])] = f"{kind}: {target}\n{ended.late}\n{ended.err[-4000:]}"
    return len(told), found


def batches(base, targets, minutes):
    """Targets and the seeds of a batch of each, with its seconds, until the time has passed."""
    rng = random.Random(base)
    seeds = itertools.count(base * 1_000_000)
    until = time.monotonic() + 60.0 * minutes
    while time.monotonic() < until:
        name = rng.choices(targets, [TARGETS[each][1] for each in targets])[0]
        yield name, list(itertools.islice(seeds, BATCH)), BATCH_S


def run(place, drawn):
    """Do batches of cases; how many findings there were."""
    cases = Counter()
    kinds = Counter()
    for name, *seeds in drawn:
        done, found = run_batch(name, *seeds, place)
        cases[name] += done
        for seed, text in found.items():
            kind, _, detail = text.partition("\n")
            kinds[kind] += 1
            print(f"FOUND {kind}; again with --target {name} --seed {seed}", flush=True)
            print(detail, flush=True)
    for name, count in (*sorted(cases.items()), *kinds.most_common()):
        print(f"{count:>9} × {name}")
    print(f"{cases.total()} cases, {kinds.total()} findings")
    return kinds.total()


@click.command(help=__doc__, context_settings={"show_default": True})
@click.option("--minutes", default=30.0)
@click.option("--target", type=click.Choice([*TARGETS]), multiple=True, help="Only this.")
@click.option(
    "--base", type=int, default=lambda: int(time.time()), help="Which seeds: others each time."
)
@click.option("--seed", type=int, help="Do one case of --target, as a finding names it.")
@click.option(
    "--short", is_flag=True, help="The same few cases of each target, and nothing trained."
)
def main(minutes, target, base, seed, short):
    targets = target or [*TARGETS]
    place = prepare(trained=not short)
    if seed is not None:
        place = replace(place, folder=FOLDER.resolve() / "again" / "here")
        drawn = [(name, [seed], math.inf) for name in targets]
    elif short:
        drawn = [(name, range(TARGETS[name][2]), math.inf) for name in targets]
    else:
        print(f"{minutes:g} min, --base {base}", flush=True)
        drawn = batches(base, targets, minutes)
    found = run(place, drawn)
    if seed is None:
        shutil.rmtree(place.folder.parent, ignore_errors=True)
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
