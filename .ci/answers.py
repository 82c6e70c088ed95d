"""What this machine answers, to be compared with another machine's.

python .ci/answers.py FOLDER             plans, replays, and what the shipped networks say of given numbers, into FOLDER
python .ci/answers.py compare ONE OTHER  exit code 1 unless two machines' folders hold the same
"""

import json
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np

MOON = "sample:moon_highlands --rescale 20"
ENDS = "--start 90,60 --goal 450,470"
GROUND = f"{MOON} --workload limit20"
PLANS = {
    "nnpp": f"{GROUND} {ENDS} --method nnpp",
    "astar": f"{GROUND} {ENDS} --method astar",
    "corridor": f"{GROUND} {ENDS} --method corridor",
    "tobler": f"{MOON} {ENDS} --step-cost tobler --method astar",
    "any-angle": f"{GROUND} {ENDS} --method corridor --refine any-angle",
    "body": "sample:moon_rocks --vehicle large-rover --start 60,6 --goal 60,113 --method corridor",
}
REPLAYS = ("auto", "corridor", "nnpp")
"""Methods by which the loop answers a drive."""
FILES = ("path.geojson", "path.csv", "plan.json")
TIMES = ("timings_ms", "loading_included", "files", "planning_ms")
ROUNDED = 1.5 / 255.0
"""Most that networks may differ by: int8 products may be rounded another way."""


def write_drive(path: Path) -> None:
    """A recording for the loop: a pose and a patch each tick, another goal each hundredth."""
    rng = np.random.default_rng(1)
    with path.open("w") as file:
        for tick in range(300):
            row, col = (int(place) for place in rng.integers(0, 480, 2))
            patch = {
                "row": row,
                "col": col,
                "keep_known": True,
                "cost": rng.random((9, 9)).tolist(),
            }
            told = {"pose": {"row": 90 + tick, "col": 60 + tick}, "patch": patch}
            if tick % 100 == 0:
                told["goal"] = {"row": 450 - tick, "col": 470}
            for kind, keys in told.items():
                print(json.dumps({"type": kind, "at": tick / 17.0} | keys), file=file)


def answer(folder: Path) -> None:
    import onnxruntime

    def call(words: str, path: Path) -> None:
        """Call the program, and keep what it prints."""
        command = [sys.executable, "-P", "-m", "nnpp_edge.cli.main", *words.split()]
        with path.open("w") as printed:
            subprocess.run(command, check=True, stdout=printed)

    folder.mkdir(parents=True)
    for name, words in PLANS.items():
        call(f"plan {words} -o {folder / name}", folder / f"{name}.txt")
    write_drive(folder / "drive.jsonl")
    replay = f"--input replay:{folder}/drive.jsonl --fast"
    for method in REPLAYS:
        call(f"run --map {GROUND} {replay} --method {method}", folder / f"{method}.jsonl")
    said, rng = {}, np.random.default_rng(0)
    for path in sorted(Path(str(files("nnpp_edge.models"))).glob("*.onnx")):
        session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
        given = {}
        for each in session.get_inputs():
            shape = [side if isinstance(side, int) else 64 for side in each.shape]
            numbers = rng.random(shape, np.float32)
            given[each.name] = numbers if "float" in each.type else (255 * numbers).astype(np.uint8)
            if "bool" in each.type:
                given[each.name] = np.ones(shape, bool)
        for output, numbers in zip(session.get_outputs(), session.run(None, given), strict=True):
            said[f"{path.stem} {output.name}"] = numbers
    np.savez(folder / "networks.npz", **said)


def plan_of(folder: Path) -> list[object]:
    """What a plan wrote, but for times."""
    texts = [(folder / name).read_text() for name in FILES]
    return [
        *texts[:-1],
        {key: value for key, value in json.loads(texts[-1]).items() if key not in TIMES},
    ]


def drive_of(path: Path) -> list[object]:
    """What the loop answered in each tick, but for times."""
    answers = map(json.loads, path.read_text().splitlines())
    return [
        {key: value for key, value in each.items() if key not in TIMES}
        for each in answers
        if each["type"] == "path"
    ]


def compare(one: Path, other: Path) -> bool:
    same = True
    for name in PLANS:
        equal = plan_of(one / name) == plan_of(other / name)
        print(f"plan {name}: {'the same' if equal else 'ANOTHER'}")
        same &= equal
    for name in REPLAYS:
        equal = drive_of(one / f"{name}.jsonl") == drive_of(other / f"{name}.jsonl")
        print(f"replay {name}: {'the same' if equal else 'ANOTHER'}")
        same &= equal
    said, others = np.load(one / "networks.npz"), np.load(other / "networks.npz")
    for name in said.files:
        apart = float(
            np.max(np.abs(said[name].astype(float) - others[name].astype(float)), initial=0.0)
        )
        allowed = 1.0 if said[name].dtype == np.uint8 else ROUNDED
        print(f"network {name}: {'the same' if apart == 0.0 else f'at most {apart:.2g} apart'}")
        same &= apart <= allowed
    return same


if __name__ == "__main__":
    if sys.argv[1] == "compare":
        sys.exit(not compare(Path(sys.argv[2]), Path(sys.argv[3])))
    answer(Path(sys.argv[1]))
