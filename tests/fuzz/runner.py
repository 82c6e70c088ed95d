"""Cases of every target, by turns, in processes of their own; findings are counted, kept and told with their seed."""

import contextlib
import inspect
import json
import math
import multiprocessing
import os
import random
import shutil
import signal
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from tests.fuzz.children import Limits, run_forked, threads
from tests.fuzz.commands import Problem
from tests.fuzz.commands import check as check_command

FOLDER = Path("build/fuzz")
BATCH, BATCH_S = 200, 20.0
"""Cases that one forked process does one after another, and seconds after which it begins no other."""
MOST_KEPT = 3
"""Findings of one cause that are kept in full."""
SHARES = {
    "files": 3.0,
    "options": 3.0,
    "models": 1.5,
    "weights": 1.5,
    "messages": 1.5,
    "sequences": 2.0,
    "elevations": 1.5,
    "bodies": 1.5,
    "layers": 1.5,
    "lines": 1.0,
    "limits": 1.5,
    "projections": 0.5,
}
"""Of the time, for each target."""
COMMAND_TARGETS = ("files", "options", "models")
"""Each case of these is a process; those of the others are functions, done in batches."""
IN_BATCH = Limits(wall_s=120.0, cpu_s=100, memory_bytes=1 << 30)


@dataclass(frozen=True)
class Finding:
    """A case in which an oracle found something."""

    target: str
    seed: int
    problem: Problem


@dataclass
class Tally:
    """What was done so far."""

    cases: Counter[str] = field(default_factory=Counter)
    seconds: Counter[str] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)

    def text(self) -> str:
        """For people."""
        lines = [f"{'target':<12}{'cases':>9}{'a second':>10}{'findings':>10}"]
        for name in sorted(self.cases):
            found = sum(finding.target == name for finding in self.findings)
            rate = self.cases[name] / max(self.seconds[name], 1e-9)
            lines.append(f"{name:<12}{self.cases[name]:>9}{rate:>10.1f}{found:>10}")
        lines.append(f"{'all':<12}{self.cases.total():>9}{'':>10}{len(self.findings):>10}")
        causes = Counter(f"{finding.target}: {finding.problem.signature}" for finding in self.findings)
        first = {}
        for finding in self.findings:
            first.setdefault(f"{finding.target}: {finding.problem.signature}", finding)
        for cause, count in causes.most_common():
            lines.append(
                f"{count:>6} × {cause}; again with --target {first[cause].target} --seed {first[cause].seed}"
            )
        return "\n".join(lines)


def case_of(target: str, seed: int, samples: Path, *, heavy: bool = True) -> Any:
    """The case of a seed, which decides all of it."""
    return _called(_module(target).generate, random.Random(f"{target} {seed}"), samples=samples, heavy=heavy)


def check_case(target: str, seed: int, samples: Path, folder: Path, *, heavy: bool = True) -> Problem | None:
    """Make the case of a seed, and look for what is wrong with it."""
    case = case_of(target, seed, samples, heavy=heavy)
    if target in COMMAND_TARGETS:
        return check_command(case, samples, folder)
    folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return cast("Problem | None", _called(_module(target).check, case, samples=samples, folder=folder))


def describe(target: str, seed: int, samples: Path, *, heavy: bool = True) -> str:
    """The case of a seed in words."""
    return repr(case_of(target, seed, samples, heavy=heavy))


def _module(target: str) -> ModuleType:
    return import_module(f"tests.fuzz.{target}")


def _called(function: Callable[..., Any], first: object, **others: object) -> Any:
    """A target's function, given of the others what it takes."""
    taken = inspect.signature(function).parameters
    return function(first, **{name: value for name, value in others.items() if name in taken})


def prepare(folder: Path, *, heavy: bool) -> Path:
    """Make the samples, and load all that the cases need; the folder of the samples. Leaves no thread behind."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    samples = folder / "samples"
    _load(heavy)
    if not (samples / "made").exists():
        _make(samples, folder, heavy)
    from nnpp_edge.runtime.exercises import exercise

    exercise()
    if threads() > 4:  # onnxruntime has a few that sleep
        print(f"warning: {threads()} threads in the process that forks", file=sys.stderr)
    return samples


def _load(heavy: bool) -> None:
    """Import what the commands import when they need it."""
    import cv2
    import matplotlib.font_manager
    import onnx
    import onnxruntime
    import PIL.Image
    import rasterio

    import nnpp_edge.viz.picture
    import nnpp_edge.viz.sheet
    from tests.fuzz import options

    matplotlib.use("Agg")
    cv2.setNumThreads(1)
    onnxruntime.set_default_logger_severity(2)
    assert all((onnx, PIL.Image, rasterio, nnpp_edge.viz, *map(_module, SHARES)))
    for name in options.names():
        options.command_of(name)
    if heavy:
        import torch

        import nnpp_edge.export.to_onnx
        import nnpp_edge.training.train

        assert torch and nnpp_edge.export.to_onnx and nnpp_edge.training.train


def _make(samples: Path, folder: Path, heavy: bool) -> None:
    """Make the samples, apart from this process: what makes them starts threads."""
    from tests.fuzz import samples as maker
    from tests.fuzz.commands import exit_code_of

    samples.mkdir(parents=True, exist_ok=True)

    def light() -> int:
        maker.make_light(samples)
        return 0

    def run(*words: object) -> bool:
        def work() -> int:
            sys.argv = ["nnpp-edge", *map(str, words)]
            os.chdir(folder / "making")
            from nnpp_edge.cli.main import main

            return exit_code_of(main)

        (folder / "making").mkdir(exist_ok=True)
        if not (folder / "making" / "in").exists():
            (folder / "making" / "in").symlink_to(samples.resolve())
        ended = run_forked(work, Limits(600.0, 600, 8 << 30))
        if ended.code not in (0, 1):
            print(ended.err.decode()[-2000:], file=sys.stderr)
        return ended.code in (0, 1)

    ended = run_forked(light, Limits(120.0, 120, 8 << 30))
    if ended.code:
        raise RuntimeError(f"the samples could not be made: {ended.err.decode()[-2000:]}")
    if heavy and (missing := maker.make_heavy(samples.resolve(), run)):
        raise RuntimeError(f"no samples by {', '.join(missing)}")
    (samples / "made").write_text("")


def seeds_of(base: int, worker: int, workers: int) -> Iterator[int]:
    """The seeds of one worker: no other one has them."""
    at = base * 1_000_000 + worker
    while True:
        yield at
        at += workers


def work(
    connection: Connection,
    worker: int,
    workers: int,
    base: int,
    targets: Sequence[str],
    until: float,
    most: Mapping[str, int],
    folder: Path,
    heavy: bool,
) -> None:
    """A worker: the cases whose turn it is, until the time has passed or each target has had so many."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    samples = prepare(folder, heavy=heavy)
    case_folder = folder.resolve() / f"case-{worker}" / "here"
    seeds = {name: seeds_of(base, worker, workers) for name in targets}
    done, spent = Counter[str](), Counter[str]()
    connection.send(("ready", 0, 0.0, []))
    while (
        open_targets := [name for name in targets if done[name] < most.get(name, sys.maxsize)]
    ) and time.time() < until:
        name = min(open_targets, key=lambda each: spent[each] / SHARES[each])
        began = time.monotonic()
        if name in COMMAND_TARGETS:
            seed = next(seeds[name])
            found = [(seed, problem)] if (problem := _checked(name, seed, samples, case_folder, heavy)) else []
            count = 1
        else:
            most_now = min(BATCH, most.get(name, sys.maxsize) - done[name])
            count, found = run_batch(name, seeds[name], most_now, samples, case_folder)
        seconds = time.monotonic() - began
        done[name] += count
        spent[name] += max(seconds, 1e-6)
        connection.send((name, count, seconds, found))
    connection.send(("done", 0, 0.0, []))


def _checked(name: str, seed: int, samples: Path, folder: Path, heavy: bool) -> Problem | None:
    """A case's problem. What depends on time is tried again, as other programs may have held it up."""
    try:
        problem = check_case(name, seed, samples, folder, heavy=heavy)
        if problem is not None and problem.kind.startswith(("hangs", "cannot be interrupted")):
            problem = check_case(name, seed, samples, folder, heavy=heavy)
        return problem
    except Exception:
        return Problem("the fuzzer itself raised", traceback.format_exc())


def run_batch(
    name: str, seeds: Iterator[int], most: int, samples: Path, folder: Path
) -> tuple[int, list[tuple[int, Problem]]]:
    """Several cases in one forked process; a case that hangs, crashes or takes too much memory ends it."""
    read, write = os.pipe()
    chosen = [next(seeds) for _ in range(most)]
    trace = folder.with_suffix(".stack")
    trace.parent.mkdir(parents=True, exist_ok=True)

    def batch() -> int:
        until = time.monotonic() + BATCH_S
        with os.fdopen(write, "w") as report:
            for seed in chosen:
                if time.monotonic() > until:
                    break
                print(json.dumps({"seed": seed}), file=report, flush=True)
                problem = _checked(name, seed, samples, folder, True)
                detail = None if problem is None else (problem.kind, problem.detail[:20_000])
                print(json.dumps({"seed": seed, "problem": detail}), file=report, flush=True)
        return 0

    lines: list[str] = []
    with _reading(read, lines):
        ended = run_forked(batch, IN_BATCH, trace=trace)
        os.close(write)
    told = [json.loads(line) for line in lines]
    finished = [entry for entry in told if "problem" in entry]
    found = [(entry["seed"], Problem(*entry["problem"])) for entry in finished if entry["problem"]]
    if ended.code and told and "problem" not in told[-1]:
        kind = f"hangs: {name}" if ended.late else f"killed by signal {-ended.code}: {name}"
        found.append(
            (told[-1]["seed"], Problem(kind, f"{ended.late}\n{ended.err.decode('utf-8', 'replace')[-4000:]}"))
        )
    return max(len(finished), 1), found


@contextlib.contextmanager
def _reading(descriptor: int, lines: list[str]) -> Iterator[None]:
    """Collect what comes through a pipe; it holds less than a pipe's room or is read at the end."""
    import fcntl

    with contextlib.suppress(OSError):
        fcntl.fcntl(descriptor, 1031, 1 << 20)  # F_SETPIPE_SZ
    try:
        yield
    finally:
        with os.fdopen(descriptor) as stream:
            lines += stream.read().splitlines()


def run(
    *,
    base: int,
    minutes: float = math.inf,
    most: Mapping[str, int] | None = None,
    workers: int = 2,
    targets: Sequence[str] = tuple(SHARES),
    folder: Path = FOLDER,
    heavy: bool = True,
    tell: Callable[[str], None] = print,
) -> Tally:
    """Run workers until the time has passed, or so many cases of each target are done."""
    folder.mkdir(parents=True, exist_ok=True)
    findings = folder / "findings"
    findings.mkdir(exist_ok=True)
    context = multiprocessing.get_context("spawn")
    tally, kept = Tally(), Counter[str]()
    until = time.time() + 60.0 * minutes
    processes = {}
    for at in range(workers):
        ours, theirs = context.Pipe()
        share = {name: -(-count // workers) for name, count in (most or {}).items()}
        arguments = (theirs, at, workers, base, tuple(targets), until, share, folder.resolve(), heavy)
        process = context.Process(target=work, args=arguments)
        process.start()
        theirs.close()
        processes[ours] = process
        if not ours.poll(900.0) or ours.recv()[0] != "ready":  # the first makes the samples
            process.kill()
            raise RuntimeError("a worker did not start")
    told = time.monotonic()
    while processes:
        for connection in wait(list(processes), 5.0):
            try:
                name, count, seconds, found = connection.recv()  # type: ignore[union-attr]
            except EOFError:
                tell("a worker died")
                tally.findings.append(Finding("runner", base, Problem("a worker died")))
                name = "done"
            if name == "done":
                processes.pop(connection).join()  # type: ignore[call-overload]
                continue
            tally.cases[name] += count
            tally.seconds[name] += seconds
            for seed, problem in found:
                finding = Finding(name, seed, problem)
                tally.findings.append(finding)
                kept[f"{name} {problem.signature}"] += 1
                if kept[f"{name} {problem.signature}"] <= MOST_KEPT:
                    keep(findings, finding)
                    tell(f"FOUND {name}: {problem.signature}; again with --target {name} --seed {seed}")
        if time.monotonic() - told > 60.0:
            told = time.monotonic()
            counts = ", ".join(f"{name} {count}" for name, count in sorted(tally.cases.items()))
            tell(f"{counts}; {len(tally.findings)} findings")
    for at in range(workers):
        shutil.rmtree(folder / f"case-{at}", ignore_errors=True)
    return tally


def keep(folder: Path, finding: Finding) -> None:
    """Write a finding down."""
    name = f"{finding.target}-{finding.seed}.txt"
    again = f"python -m tests.fuzz --target {finding.target} --seed {finding.seed}"
    content = f"{finding.problem.signature}\n{again}\n\n{finding.problem.kind}\n{finding.problem.detail}\n"
    (folder / name).write_text(content, errors="backslashreplace")
