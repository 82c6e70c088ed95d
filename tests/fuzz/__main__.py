"""Look for what the oracles refuse, for so many minutes; or do one case again."""

import itertools
import os
import random
import shutil
import sys
import time
import traceback
import warnings
from collections import Counter
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import click

from tests.fuzz import samples
from tests.fuzz.cases import Place, Problem
from tests.fuzz.children import ROOMY, Limits, run_forked

FOLDER = Path("build/fuzz")
BATCH = 200
BATCH_S = 5.0
"""Cases that one forked process does one after another, and seconds after which it begins
no other.
"""
SHARES = {
    "options": 15,
    "layers": 6,
    "sequences": 7,
    "elevations": 3,
    "bodies": 3,
    "projections": 1,
}
"""Of the batches, for each target."""
MOST_TOLD = 3  # findings of one kind that are told in full
LOADED = str.split(
    "cv2 matplotlib.font_manager onnx onnxruntime PIL.Image rasterio torch nnpp_edge.viz.picture "
    "nnpp_edge.export.to_onnx nnpp_edge.training.train"
)


def case_of(target, seed, place):
    """The case of a seed, which decides all of it."""
    return import_module(f"tests.fuzz.{target}").generate(random.Random(f"{target} {seed}"), place)


def check_case(target, seed, place):
    """Make the case of a seed, and look for what is wrong with it."""
    place.folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return import_module(f"tests.fuzz.{target}").check(case_of(target, seed, place), place)


def prepare():
    """Make the samples where they are not there yet, and load all that cases need. Leaves no thread
    behind.
    """
    folder = FOLDER.resolve()
    made = folder / "samples" / "made"
    if not made.exists():
        ended = run_forked(lambda: samples.make_light(made.parent), ROOMY)
        assert ended.code == 0, ended.err
        samples.make_heavy(made.parent)
        made.write_text("")
    one_thread = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    os.environ.update(dict.fromkeys(one_thread, "1"))
    for name in (*LOADED, *(f"tests.fuzz.{target}" for target in SHARES)):
        import_module(name)
    import cv2
    import matplotlib
    import onnxruntime

    from nnpp_edge.runtime.exercises import exercise
    from tests.fuzz import options

    matplotlib.use("Agg")
    cv2.setNumThreads(1)
    onnxruntime.set_default_logger_severity(2)
    for name in options.BASES:
        options.command_of(name)
    exercise()
    return Place(made.parent, folder / f"case-{os.getpid()}" / "here")


def run_batch(target, seeds, place):
    """How many cases were done, and what was found, by the seed.

    They are done in one forked process; a case that hangs, crashes or takes too much memory ends
    it.
    """
    until = time.monotonic() + BATCH_S

    def batch():
        for seed in seeds:
            print(f"\0{seed}", flush=True)
            try:
                problem = check_case(target, seed, place)
            except Exception:
                problem = Problem("the fuzzer itself raised", traceback.format_exc())
            if problem is not None:
                print(f"{problem.kind}\n{problem.detail[:20_000]}".replace("\0", "␀"), flush=True)
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


def run(base, targets, minutes):
    """Do cases of the targets until the time has passed; how many findings there were."""
    place = prepare()
    rng = random.Random(base)
    seeds = itertools.count(base * 1_000_000)
    cases = Counter()
    kinds = Counter()
    until = time.monotonic() + 60.0 * minutes
    while time.monotonic() < until:
        name = rng.choices(targets, [SHARES[each] for each in targets])[0]
        done, found = run_batch(name, list(itertools.islice(seeds, BATCH)), place)
        cases[name] += done
        for seed, text in found.items():
            kind, _, detail = text.partition("\n")
            kinds[kind] += 1
            print(f"FOUND {kind}; again with --target {name} --seed {seed}", flush=True)
            print(detail if kinds[kind] <= MOST_TOLD else "", flush=True)
    shutil.rmtree(place.folder.parent, ignore_errors=True)
    for name, count in (*sorted(cases.items()), *kinds.most_common()):
        print(f"{count:>9} × {name}")
    print(f"{cases.total()} cases, {kinds.total()} findings")
    return kinds.total()


@click.command(help=__doc__, context_settings={"show_default": True})
@click.option("--minutes", default=30.0)
@click.option("--target", type=click.Choice([*SHARES]), multiple=True, help="Only this.")
@click.option(
    "--base", type=int, default=lambda: int(time.time()), help="Which seeds: others each time."
)
@click.option("--seed", type=int, help="Do one case of --target, as a finding names it.")
def main(minutes, target, base, seed):
    if seed is None:
        print(f"{minutes:g} min, --base {base}", flush=True)
        found = run(base, target or [*SHARES], minutes)
    elif len(target) != 1:
        raise click.UsageError("give the --target of the --seed")
    else:
        place = replace(prepare(), folder=FOLDER.resolve() / "again" / "here")
        print(repr(case_of(target[0], seed, place)))
        found = check_case(target[0], seed, place)
        print(f"\n{found.kind}\n{found.detail}" if found else "\nnothing was found")
        print(f"its folder: {place.folder}")
    sys.stdout.flush()
    os._exit(1 if found else 0)  # threads of libraries are not waited for


if __name__ == "__main__":
    main()
