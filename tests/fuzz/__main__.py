"""`python -m tests.fuzz`: look for what the oracles refuse, for so many minutes; or do one case again."""

import argparse
import os
import sys
import time
from pathlib import Path

from tests.fuzz.runner import COMMAND_TARGETS, FOLDER, SHARES, check_case, describe, prepare, run


def main() -> int:
    """0 where nothing was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--target", action="append", choices=list(SHARES), help="only this; may be repeated")
    parser.add_argument("--base", type=int, help="which seeds are drawn; by default others each time")
    parser.add_argument("--seed", type=int, help="do one case of --target, as a finding names it")
    parser.add_argument("--light", action="store_true", help="without the samples that are trained")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    given = parser.parse_args()
    if given.seed is not None:
        if len(given.target or ()) != 1:
            parser.error("give the --target of the --seed")
        return again(given.target[0], given.seed, given.folder.resolve(), heavy=not given.light)
    base = int(time.time()) if given.base is None else given.base
    print(f"{given.minutes:g} min, {given.workers} workers, --base {base}", flush=True)
    began = time.monotonic()
    tally = run(
        base=base,
        minutes=given.minutes,
        workers=given.workers,
        targets=given.target or tuple(SHARES),
        folder=given.folder,
        heavy=not given.light,
        tell=lambda line: print(line, flush=True),
    )
    print(tally.text())
    print(f"{tally.cases.total()} cases in {(time.monotonic() - began) / 60.0:.1f} min")
    return 1 if tally.findings else 0


def again(target: str, seed: int, folder: Path, *, heavy: bool) -> int:
    """Do the case of one seed; its folder is left to look at."""
    samples = prepare(folder, heavy=heavy)
    here = folder / "again" / "here"
    print(describe(target, seed, samples, heavy=heavy))
    problem = check_case(target, seed, samples, here, heavy=heavy)
    print(f"\n{problem.kind}\n{problem.detail}" if problem else "\nnothing was found")
    if target in COMMAND_TARGETS:
        print(f"its folder: {here}")
    return 1 if problem else 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # threads of libraries are not waited for
