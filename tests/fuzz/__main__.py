"""`python -m tests.fuzz`: look for what the oracles refuse, for so many minutes; or do one case
again.
"""

import argparse
import itertools
import os
import random
import shutil
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from tests.fuzz import samples
from tests.fuzz.cases import Place, Problem
from tests.fuzz.children import Limits, run_forked

FOLDER = Path("build/fuzz")
BATCH = 200
BATCH_S = 5.0
"""Cases that one forked process does one after another, and seconds after which it begins
no other.
"""
SHARES = {"options": 7.5, "weights": 1.5, "messages": 1.5, "sequences": 2.0, "elevations": 1.5}
SHARES |= {"bodies": 1.5, "layers": 1.5, "lines": 1.0, "projections": 0.5}
"""Of the time, for each target."""
MOST_TOLD = 3  # findings of one kind that are told in full
LOADED = (
    *str.split(
        "cv2 matplotlib.font_manager onnx onnxruntime PIL.Image rasterio torch "
        "nnpp_edge.viz.picture"
    ),
    *("nnpp_edge.export.to_onnx", "nnpp_edge.training.train"),
)


def case_of(target: str, seed: int, place: Place) -> Any:
    """The case of a seed, which decides all of it."""
    return import_module(f"tests.fuzz.{target}").generate(random.Random(f"{target} {seed}"), place)


def check_case(target: str, seed: int, place: Place) -> Problem | None:
    """Make the case of a seed, and look for what is wrong with it."""
    assert place.folder is not None
    place.folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found: Problem | None = import_module(f"tests.fuzz.{target}").check(
            case_of(target, seed, place), place
        )
        return found


def prepare() -> Place:
    """Make the samples where they are not there yet, and load all that cases need. Leaves no thread
    behind.
    """
    folder = FOLDER.resolve()
    if not (folder / "samples" / "made").exists():
        assert (
            run_forked(
                lambda: samples.make_light(folder / "samples") or 0, Limits(120.0, 120, 8 << 30)
            ).code
            == 0
        )
        samples.make_heavy(folder / "samples")
        (folder / "samples" / "made").write_text("")
    os.environ.update(
        dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    )
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
    return Place(folder / "samples", folder / f"case-{os.getpid()}" / "here")


def run_batch(target: str, seeds: Iterable[int], place: Place) -> tuple[int, dict[int, str]]:
    """How many cases were done, and what was found, by the seed.

    They are done in one forked process; a case that hangs, crashes or takes too much memory ends
    it.
    """
    until = time.monotonic() + BATCH_S

    def batch() -> int:
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
        return 0

    by_itself = target == "options"  # its cases are watched one by one
    ended = run_forked(
        batch, Limits(900.0, 900, 64 << 30) if by_itself else Limits(120.0, 100, 1 << 30)
    )
    told = [each.partition("\n") for each in ended.out.decode("utf-8", "replace").split("\0")[1:]]
    found = {int(seed): text.strip() for seed, _, text in told if text.strip()}
    if ended.code:
        kind = "hangs" if ended.late else f"killed by signal {-ended.code}"
        found[int(told[-1][0])] = (
            f"{kind}: {target}\n{ended.late}\n{ended.err.decode('utf-8', 'replace')[-4000:]}"
        )
    return len(told), found


def run(base: int, targets: Sequence[str], minutes: float) -> int:
    """Do cases of each target by turns until the time has passed; how many findings there were."""
    place = prepare()
    seeds = itertools.count(base * 1_000_000)
    cases = Counter[str]()
    seconds = Counter[str]()
    kinds = Counter[str]()
    until = time.monotonic() + 60.0 * minutes
    while time.monotonic() < until:
        name = min(targets, key=lambda each: seconds[each] / SHARES[each])
        began = time.monotonic()
        done, found = run_batch(name, list(itertools.islice(seeds, BATCH)), place)
        cases[name] += done
        seconds[name] += time.monotonic() - began
        for seed, text in found.items():
            kind, _, detail = text.partition("\n")
            kinds[kind] += 1
            print(f"FOUND {kind}; again with --target {name} --seed {seed}", flush=True)
            print(detail if kinds[kind] <= MOST_TOLD else "", flush=True)
    shutil.rmtree(place.folder.parent, ignore_errors=True)  # type: ignore[union-attr]
    for name in sorted(cases):
        print(f"{name:<12}{cases[name]:>9} in {seconds[name]:.0f} s")
    for kind, count in kinds.most_common():
        print(f"{count:>6} × {kind}")
    print(f"{cases.total()} cases, {kinds.total()} findings")
    return kinds.total()


def main() -> int:
    """0 where nothing was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument(
        "--target", action="append", choices=list(SHARES), help="only this; may be repeated"
    )
    parser.add_argument(
        "--base",
        type=int,
        default=int(time.time()),
        help="which seeds; by default others each time",
    )
    parser.add_argument("--seed", type=int, help="do one case of --target, as a finding names it")
    given = parser.parse_args()
    targets = given.target or list(SHARES)
    if given.seed is None:
        print(f"{given.minutes:g} min, --base {given.base}", flush=True)
        return 1 if run(given.base, targets, given.minutes) else 0
    if len(targets) != 1:
        parser.error("give the --target of the --seed")
    place = replace(prepare(), folder=FOLDER.resolve() / "again" / "here")
    print(repr(case_of(targets[0], given.seed, place)))
    problem = check_case(targets[0], given.seed, place)
    print(f"\n{problem.kind}\n{problem.detail}" if problem else "\nnothing was found")
    print(f"its folder: {place.folder}")
    return 1 if problem else 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # threads of libraries are not waited for
