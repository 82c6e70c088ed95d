"""Small valid files of every format that the commands read, made once into a folder."""

import json
import os
import shutil
import sys

import numpy as np

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


def make_light(folder):
    """All that needs no training: terrain, cost maps, recordings, profiles, the smallest model."""
    import rasterio.shutil

    from nnpp_edge.robot.transports.wire import encode
    from nnpp_edge.runtime.loop.messages import Goal, MapPatch, Pose
    from tests.conftest import write_tiny_model

    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    known = rng.normal(0.0, 0.02, (ROWS, COLS)).cumsum(0).cumsum(1).astype(np.float32)
    ground = known.copy()
    ground[ROWS // 3, COLS // 3 : COLS // 2] = np.nan
    cell = {"cell_size_m": CELL_M}
    np.save(folder / "dem.npy", ground)
    np.savez(folder / "dem.npz", elevation_m=ground, **cell)
    place = rasterio.Affine(CELL_M, 0, 1000, 0, -CELL_M, 2000)
    kind = {"driver": "GTiff", "count": 1, "dtype": "float32", "transform": place}
    kind |= {"height": ROWS, "width": COLS, "nodata": -9999.0}
    with rasterio.open(folder / "dem.tif", "w", **kind) as dataset:
        dataset.write(np.nan_to_num(ground, nan=-9999.0), 1)
    rasterio.shutil.copy(folder / "dem.tif", folder / "dem.asc", driver="AAIGrid")
    (folder / "N10E010.hgt").write_bytes(np.full((1201, 1201), 100, ">i2").tobytes())
    label = LABEL.format(bytes=4 * COLS, records=ROWS + 8, rows=ROWS, cols=COLS).encode()
    (folder / "dem.img").write_bytes(label.ljust(8 * 4 * COLS) + known.astype("<f4").tobytes())
    cost = rng.uniform(0.0, 0.9, (ROWS, COLS)).astype(np.float32)
    cost[5, 3:20] = np.inf
    np.savez_compressed(folder / "cost.npz", cost=cost, cell_width_m=CELL_M, **cell)
    messages = [
        encode(Pose(2.0, 2.0)),
        encode(Goal(20, 28)),
        encode(MapPatch(3, 4, elevation=ground[:4, :5])),
        encode(Pose(4.0, 4.0)),
        encode(MapPatch(10, 9, cost=np.full((2, 3), 1.0, np.float32), keep_known=True)),
    ]
    timed = [b'{"at":%.3f,' % (0.01 * at) + each[1:] for at, each in enumerate(messages)]
    first = json.dumps({"v": 1, "type": "recording", "map": [ROWS, COLS]}).encode()
    (folder / "drive.jsonl").write_bytes(b"\n".join((first, *timed, b"")))
    (folder / "messages.jsonl").write_bytes(b"\n".join((*messages, b"")))
    (folder / "profile.toml").write_text(PROFILE)
    write_tiny_model(folder / "tiny.onnx")
    (folder / "tiny.md").write_text("# tiny\n\nA model without weights.\n")
    (folder / "tiny.json").write_text(REPORT)


COMMANDS = (
    "dataset -o in/set --maps 2 --size 64 --points 2 --workers 1",
    "train in/set --validation in/set -o in/trained --steps 1 --input-size 64 --batch 2 "
    "--validations 3",
    "export in/trained/best.pt -o in/edge64.onnx",
    "profile --profile in/profile.toml -o in",
)
"""They make a data set, a checkpoint, a trained model and a report."""


def make_trained(folder):
    """What must be trained or measured, by the commands themselves; in a process of its own."""
    from nnpp_edge.cli.main import main

    making = folder.parent / "making"
    making.mkdir(exist_ok=True)
    if not (making / "in").exists():
        (making / "in").symlink_to(folder)
    os.chdir(making)
    for words in COMMANDS:
        sys.argv = ["nnpp-edge", *words.split()]
        try:
            main()
        except SystemExit as ended:
            assert ended.code in (None, 0, 1), words  # a missed budget
    shutil.copy(folder / "report.json", folder / "another.json")
