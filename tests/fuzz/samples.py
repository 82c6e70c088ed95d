"""Small valid files of every format that the commands read, made once into a folder."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = str(Path(__file__).parents[2])
# enough for a data set
ROWS = 132
COLS = 140
CELL_M = 2.0
DEMS = ("dem.npy", "dem.npz", "dem.tif", "dem.asc", "N10E010.hgt", "dem.img")
PROFILE = """planner = "auto"
budgets = [{ name = "mean gap", quantity = "gap_mean", limit = 100.0, direction = "at most", unit = "%" }]
[device]
cores = [0]
[workload]
terrain = ["synthetic"]
workloads = ["soft"]
sizes = [32]
queries = 1
repeats = 1
[model]
int8 = "in/tiny.onnx"
[loop]
rate_hz = 500.0
method = "corridor"
"""
REPORT = """{
  "machine": "any", "commands": ["none"], "rows": [{
    "workload": "soft", "size": 256, "method": "nnpp", "n": 2, "success_raw": 1.0, "success": 1.0,
    "gap_mean": 0.0, "gap_p99": 0.0, "time_ms_median": 1.0, "time_ms_p99": 1.0,
    "speedup_median": 2.0, "speedup_total": 2.0, "mm_mean": 0.1
  }]
}"""
LABEL = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = {bytes}
FILE_RECORDS = {records}
^IMAGE = 9
OBJECT = IMAGE
  LINES = {rows}
  LINE_SAMPLES = {cols}
  SAMPLE_TYPE = PC_REAL
  SAMPLE_BITS = 32
  BANDS = 1
END_OBJECT = IMAGE
END
"""


def heights(seed: int = 0, rows: int = ROWS, cols: int = COLS) -> np.ndarray:
    """Gentle hills with a hole in them, metres."""
    rng = np.random.default_rng(seed)
    ground = np.cumsum(np.cumsum(rng.normal(0.0, 0.02, (rows, cols)), axis=0), axis=1)
    ground[rows // 3, cols // 3 : cols // 2] = np.nan
    return ground.astype(np.float32)


def make_light(folder: Path) -> None:
    """All that needs no training: terrain, cost maps, recordings, profiles, the smallest model."""
    import rasterio

    from nnpp_edge.robot.transports.wire import encode
    from nnpp_edge.runtime.loop.messages import Goal, MapPatch, Pose
    from tests.conftest import write_tiny_model

    folder.mkdir(parents=True, exist_ok=True)
    ground = heights()
    known = np.nan_to_num(ground)
    marked = np.nan_to_num(ground, nan=-9999.0)
    np.save(folder / "dem.npy", ground)
    np.savez(folder / "dem.npz", elevation_m=ground, cell_size_m=CELL_M)
    place = rasterio.Affine(CELL_M, 0, 1000, 0, -CELL_M, 2000)
    kind = {"driver": "GTiff", "count": 1, "dtype": "float32", "transform": place}
    with rasterio.open(
        folder / "dem.tif", "w", nodata=-9999.0, height=ROWS, width=COLS, **kind
    ) as dataset:
        dataset.write(marked, 1)
    head = (
        f"ncols {COLS}\nnrows {ROWS}\nxllcorner 0\nyllcorner 0\ncellsize "
        f"{CELL_M}\nNODATA_value -9999"
    )
    np.savetxt(folder / "dem.asc", marked, "%.3f", header=head, comments="")
    (folder / "N10E010.hgt").write_bytes(
        np.tile(known[:1, :1], (1201, 1201)).astype(">i2").tobytes()
    )
    label = LABEL.format(bytes=4 * COLS, records=ROWS + 8, rows=ROWS, cols=COLS)
    (folder / "dem.img").write_bytes(
        label.encode().ljust(8 * 4 * COLS) + known.astype("<f4").tobytes()
    )
    cost = np.random.default_rng(1).uniform(0.0, 0.9, (ROWS, COLS)).astype(np.float32)
    cost[5, 3:20] = np.inf
    np.savez_compressed(folder / "cost.npz", cost=cost, cell_size_m=CELL_M, cell_width_m=CELL_M)
    inputs = [
        Pose(2.0, 2.0),
        Goal(20, 28),
        MapPatch(3, 4, elevation=ground[:4, :5]),
        Pose(4.0, 4.0),
    ]
    inputs.append(MapPatch(10, 9, cost=np.full((2, 3), 1.0, np.float32), keep_known=True))
    lines = [
        b'{"at":%.3f,' % (0.01 * at) + encode(message)[1:] for at, message in enumerate(inputs)
    ]
    lines.insert(0, json.dumps({"v": 1, "type": "recording", "map": [ROWS, COLS]}).encode())
    (folder / "drive.jsonl").write_bytes(b"\n".join(lines) + b"\n")
    (folder / "messages.jsonl").write_bytes(b"\n".join(map(encode, inputs)) + b"\n")
    (folder / "profile.toml").write_text(PROFILE)
    write_tiny_model(folder / "tiny.onnx")
    (folder / "tiny.md").write_text("# tiny\n\nA model without weights.\n")
    (folder / "tiny.json").write_text(REPORT)


COMMANDS = (
    "dataset -o in/set --maps 2 --size 64 --points 2 --workers 1",
    "train in/set --validation in/set -o in/trained --steps 1 --input-size 64 --batch 2 "
    "--validate-every 0",
    "export in/trained/checkpoint.pt -o in/edge64.onnx",
    "profile --profile in/profile.toml -o in",
)
"""They make a data set, a checkpoint, a trained model and a report."""


def make_heavy(folder: Path) -> None:
    """What must be trained or measured, by the commands themselves."""
    making = folder.parent / "making"
    making.mkdir(exist_ok=True)
    if not (making / "in").exists():
        (making / "in").symlink_to(folder.resolve())
    command = [sys.executable, "-m", "nnpp_edge.cli.main"]
    env = os.environ | {"PYTHONPATH": ROOT}
    for words in COMMANDS:
        ended = subprocess.run([*command, *words.split()], cwd=making, env=env, capture_output=True)
        if ended.returncode not in (0, 1):
            raise RuntimeError(f"no samples by {words}: {ended.stderr.decode()[-2000:]}")
    shutil.copy(folder / "report.json", folder / "another.json")
