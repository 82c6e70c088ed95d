"""`python -m tests.fuzz`: look for what the oracles refuse, for so many minutes; or do one case again."""

import argparse
import os
import sys
import time
from dataclasses import replace

from tests.fuzz.runner import FOLDER, SHARES, case_of, check_case, prepare, run


def main() -> int:
    """0 where nothing was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--target", action="append", choices=list(SHARES), help="only this; may be repeated")
    parser.add_argument("--base", type=int, default=int(time.time()), help="which seeds; by default others each time")
    parser.add_argument("--seed", type=int, help="do one case of --target, as a finding names it")
    parser.add_argument("--light", action="store_true", help="without the samples that are trained")
    given = parser.parse_args()
    targets, heavy = given.target or list(SHARES), not given.light
    if given.seed is None:
        print(f"{given.minutes:g} min, {given.workers} workers, --base {given.base}", flush=True)
        tally = run(given.base, targets, given.minutes, given.workers, heavy=heavy)
        print(tally.text())
        return 1 if tally.findings else 0
    if len(targets) != 1:
        parser.error("give the --target of the --seed")
    place = replace(prepare(FOLDER, heavy), folder=FOLDER.resolve() / "again" / "here")
    print(repr(case_of(targets[0], given.seed, place)))
    problem = check_case(targets[0], given.seed, place)
    print(f"\n{problem.kind}\n{problem.detail}" if problem else "\nnothing was found")
    print(f"its folder: {place.folder}")
    return 1 if problem else 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # threads of libraries are not waited for
