"""`python -m tests.fuzz`: look for what the oracles refuse, for so many minutes; or do one case again."""

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

from tests.fuzz.runner import FOLDER, SHARES, case_of, check_case, make_samples, prepare, run


def main() -> int:
    """0 where nothing was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--target", action="append", choices=list(SHARES), help="only this; may be repeated")
    parser.add_argument("--base", type=int, default=int(time.time()), help="which seeds; by default others each time")
    parser.add_argument("--seed", type=int, help="do one case of --target, as a finding names it")
    parser.add_argument("--light", action="store_true", help="without the samples that are trained")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    given, began = parser.parse_args(), time.monotonic()
    targets, heavy = given.target or list(SHARES), not given.light
    if given.seed is None:
        print(f"{given.minutes:g} min, {given.workers} workers, --base {given.base}", flush=True)
        settings = {"base": given.base, "minutes": given.minutes, "workers": given.workers, "folder": given.folder}
        tally = run(targets=targets, heavy=heavy, tell=lambda line: print(line, flush=True), **settings)
        print(f"{tally.text()}\n{tally.cases.total()} cases in {(time.monotonic() - began) / 60.0:.1f} min")
        return 1 if tally.findings else 0
    if len(targets) != 1:
        parser.error("give the --target of the --seed")
    here = given.folder.resolve() / "again" / "here"
    place = replace(prepare(make_samples(given.folder, heavy), heavy), folder=here)
    print(repr(case_of(targets[0], given.seed, place)))
    problem = check_case(targets[0], given.seed, place)
    print(f"\n{problem.kind}\n{problem.detail}" if problem else "\nnothing was found")
    print(f"its folder: {here}")
    return 1 if problem else 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # threads of libraries are not waited for
