"""Cases of every target, by turns, in processes of their own; findings are counted, kept and told with their seed."""

import itertools
import json
import math
import multiprocessing
import os
import random
import shutil
import subprocess
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from tests.fuzz import commands
from tests.fuzz.cases import Place, Problem
from tests.fuzz.children import Limits, run_forked

FOLDER = Path("build/fuzz")
BATCH, BATCH_S = 200, 20.0
"""Cases that one forked process does one after another, and seconds after which it begins no other."""
MOST_KEPT = 3  # findings of one cause that are kept in full
SHARES = {"files": 4.5, "options": 3.0, "weights": 1.5, "messages": 1.5, "sequences": 2.0, "elevations": 1.5}
SHARES |= {"bodies": 1.5, "layers": 1.5, "lines": 1.0, "limits": 1.5, "projections": 0.5}
"""Of the time, for each target."""
COMMAND_TARGETS = ("files", "options")
"""Each case of these is a process; those of the others are functions, done in batches."""
IN_BATCH = Limits(wall_s=120.0, cpu_s=100, memory_bytes=1 << 30)
HEAVY = ("torch", "nnpp_edge.export.to_onnx", "nnpp_edge.training.train")
LOADED = ("cv2", "matplotlib.font_manager", "onnx", "onnxruntime", "PIL.Image", "rasterio", "nnpp_edge.viz.picture")


@dataclass(frozen=True)
class Finding:
    """A case in which an oracle found something."""

    target: str
    seed: int
    problem: Problem

    @property
    def cause(self) -> str:
        """Equal for findings of the same cause."""
        return f"{self.target}: {self.problem.signature}"

    @property
    def again(self) -> str:
        """How to do the case again."""
        return f"{self.cause}; again with --target {self.target} --seed {self.seed}"

    def keep(self, folder: Path) -> None:
        """Write it down."""
        folder.mkdir(parents=True, exist_ok=True)
        told = f"{self.again}\n\n{self.problem.kind}\n{self.problem.detail}\n"
        (folder / f"{self.target}-{self.seed}.txt").write_text(told, errors="backslashreplace")


@dataclass
class Tally:
    """The cases done so far, the seconds they took, and what was found, by target."""

    cases: Counter[str] = field(default_factory=Counter)
    seconds: Counter[str] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)

    def text(self) -> str:
        """For people."""
        lines = [f"{name:<12}{self.cases[name]:>9} in {self.seconds[name]:.0f} s" for name in sorted(self.cases)]
        first = {finding.cause: finding.again for finding in reversed(self.findings)}
        causes = Counter(finding.cause for finding in self.findings).most_common()
        lines += [f"{count:>6} × {first[cause]}" for cause, count in causes]
        return "\n".join([*lines, f"{self.cases.total()} cases, {len(self.findings)} findings"])


def case_of(target: str, seed: int, place: Place) -> Any:
    """The case of a seed, which decides all of it."""
    return import_module(f"tests.fuzz.{target}").generate(random.Random(f"{target} {seed}"), place)


def check_case(target: str, seed: int, place: Place) -> Problem | None:
    """Make the case of a seed, and look for what is wrong with it."""
    assert place.folder is not None
    case = case_of(target, seed, place)
    if target in COMMAND_TARGETS:
        return commands.check(case, place)
    place.folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found: Problem | None = import_module(f"tests.fuzz.{target}").check(case, place)
        return found


def prepare(folder: Path, heavy: bool) -> Place:
    """Make the samples where they are not there yet, and load all that cases need. Leaves no thread behind."""
    samples = folder.resolve() / "samples"
    if not (samples / "made").exists():
        subprocess.run([sys.executable, "-m", "tests.fuzz.samples", samples, *["heavy"] * heavy], check=True)
    os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    for name in (*LOADED, *(HEAVY if heavy else ()), *(f"tests.fuzz.{target}" for target in SHARES)):
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
    return Place(samples, samples.parent / f"case-{os.getpid()}" / "here", heavy)


def _checked(target: str, seed: int, place: Place) -> Problem | None:
    """A case's problem. What depends on time is tried again, as other programs may have held it up."""
    try:
        problem = check_case(target, seed, place)
        if problem is not None and problem.kind.startswith(("hangs", "cannot be interrupted")):
            problem = check_case(target, seed, place)
        return problem
    except Exception:
        return Problem("the fuzzer itself raised", traceback.format_exc())


def run_batch(target: str, seeds: Sequence[int], place: Place) -> tuple[int, list[Finding]]:
    """How many cases were done, and what was found.

    Functions are done in one forked process; a case that hangs, crashes or takes too much memory ends it.
    """
    began = time.monotonic()
    assert place.folder is not None
    place.folder.parent.mkdir(parents=True, exist_ok=True)
    if target in COMMAND_TARGETS:
        told = [(seed, _checked(target, seed, place)) for seed in seeds]
    else:

        def batch() -> int:
            for seed in seeds:
                if time.monotonic() - began > BATCH_S:
                    break
                print(f"\n\0{json.dumps([seed])}", flush=True)
                problem = _checked(target, seed, place)
                detail = problem and (problem.kind, problem.detail[:20_000])
                print(f"\n\0{json.dumps([seed, detail])}", flush=True)
            return 0

        ended = run_forked(batch, IN_BATCH, trace=place.folder.with_suffix(".stack"))
        lines = [json.loads(line[1:]) for line in ended.out.decode().splitlines() if line.startswith("\0")]
        told = [(line[0], line[1] and Problem(*line[1])) for line in lines if len(line) == 2]
        if ended.code and lines and len(lines[-1]) == 1:
            kind = f"hangs: {target}" if ended.late else f"killed by signal {-ended.code}: {target}"
            detail = f"{ended.late}\n{ended.err.decode('utf-8', 'replace')[-4000:]}"
            told.append((lines[-1][0], Problem(kind, detail)))
    return len(told), [Finding(target, *each) for each in told if each[1]]


def work(base: int, minutes: float, most: Mapping[str, int], folder: Path, heavy: bool) -> Tally:
    """Do cases until the time has passed, or so many of each target are done."""
    place, tally, seeds = prepare(folder, heavy), Tally(), itertools.count(base * 1_000_000)
    left, until = dict(most), time.monotonic() + 60.0 * minutes
    while time.monotonic() < until and any(left.values()):
        name = min(filter(left.get, left), key=lambda each: tally.seconds[each] / SHARES[each])
        count, began = min(1 if name in COMMAND_TARGETS else BATCH, left[name]), time.monotonic()
        done, found = run_batch(name, list(itertools.islice(seeds, count)), place)
        left[name] -= done
        tally.cases[name] += done
        tally.seconds[name] += time.monotonic() - began
        for finding in found:
            tally.findings.append(finding)
            if sum(each.cause == finding.cause for each in tally.findings) <= MOST_KEPT:
                finding.keep(folder / "findings")
                print(f"FOUND {finding.again}", flush=True)
    shutil.rmtree(place.folder.parent, ignore_errors=True)  # type: ignore[union-attr]
    return tally


def run(
    base: int,
    targets: Sequence[str] = tuple(SHARES),
    minutes: float = math.inf,
    workers: int = 2,
    folder: Path = FOLDER,
    heavy: bool = True,
) -> Tally:
    """Let workers, processes that have loaded everything, do cases for so many minutes."""
    one = partial(work, minutes=minutes, most=dict.fromkeys(targets, sys.maxsize), folder=folder, heavy=heavy)
    prepare(folder, heavy)  # the samples, once
    tally = Tally()
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        tallies = list(pool.map(one, range(base * workers, (base + 1) * workers)))
    for each in tallies:
        tally.cases += each.cases
        tally.seconds += each.seconds
        tally.findings += each.findings
    return tally
