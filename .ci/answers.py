"""What this machine answers, to be compared with another machine's.

python .ci/answers.py FOLDER             plans, and what the shipped networks say of given numbers, into FOLDER
python .ci/answers.py compare ONE OTHER  exit code 1 unless two machines' folders hold the same
"""

import json
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np

MOON = "sample:moon_highlands --rescale 20 --start 90,60 --goal 450,470"
PLANS = {
    "nnpp": f"{MOON} --workload limit20 --method nnpp",
    "astar": f"{MOON} --workload limit20 --method astar",
    "corridor": f"{MOON} --workload limit20 --method corridor",
    "tobler": f"{MOON} --step-cost tobler --method astar",
    "any-angle": f"{MOON} --workload limit20 --method corridor --refine any-angle",
    "body": "sample:moon_rocks --vehicle large-rover --start 60,6 --goal 60,113 --method corridor",
}
FILES = ("path.geojson", "path.csv", "plan.json")
TIMES = ("timings_ms", "loading_included", "files")
ROUNDED = 1.5 / 255.0
"""Most that networks may differ by: int8 products may be rounded another way."""


def answer(folder: Path) -> None:
    import onnxruntime

    for name, words in PLANS.items():
        command = [
            sys.executable,
            "-P",
            "-m",
            "nnpp_edge.cli.main",
            "plan",
            *words.split(),
            "-o",
            str(folder / name),
        ]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
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


def compare(one: Path, other: Path) -> bool:
    same = True
    for name in PLANS:
        equal = plan_of(one / name) == plan_of(other / name)
        print(f"plan {name}: {'the same' if equal else 'ANOTHER'}")
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
