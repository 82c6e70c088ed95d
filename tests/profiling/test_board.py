"""The table of boards: its committed rows, and how a report becomes one."""

import json
import re
from pathlib import Path

from nnpp_edge.profiling.compare import board, board_table

BOARDS = Path(__file__).parents[2] / "docs" / "boards.md"


def cells_of(line):
    """A Markdown row's cells."""
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


REPORT = json.loads("""{
  "made": "2026-05-04T10:00:00+00:00", "verdict": "met", "cores": [0, 1],
  "profile": {"name": "edge-2core", "planner": "auto"},
  "environment": {
    "cpu": "A | board\\n model", "architecture": "aarch64", "flags": ["asimd", "asimddp"],
    "cores_online": 4, "governor": null, "load_average": [0.5], "clock_mhz": 2400.0, "memory_mb": 8192, "kernel": "6.6", "system": null,
    "python": "3.12.1",
    "packages": {"nnpp-edge": "0.1.0", "numpy": "2.0", "numba": "0.60", "onnxruntime": null}
  },
  "results": [
    {"workload": "soft", "size": 256, "planner": "astar",
     "time_ms": {"median": 3.14159}, "map_ms": null},
    {"workload": "soft", "size": 256, "planner": "auto",
     "time_ms": {"median": 1}, "map_ms": {"median": 4}},
    {"workload": "soft", "size": 1024, "planner": "astar",
     "time_ms": {"median": 50}, "map_ms": null},
    {"workload": "soft", "size": 1024, "planner": "auto",
     "time_ms": {"median": 9}, "map_ms": null},
    {"workload": "limit20", "size": 256, "planner": "astar",
     "time_ms": {"median": 99}, "map_ms": null}
  ],
  "disturbance": {"halves": [
    {"waited_share": 0.01, "others_share": null},
    {"waited_share": 0, "others_share": 0.034}
  ]},
  "besides": {},
  "sensors": {
    "throttled": "", "clock_mhz": {"0": {"min": 1500.0, "max": 2400.0}}, "temperature_c": {}
  }
}""")


ROW = """
date: 2026-05-04
processor: A \\| board model
cores: 2 of 4
flags: asimd, asimddp
clock: 2400 MHz, ran at 1500 to 2400
memory: 8.0 GiB
system: Linux, kernel 6.6, aarch64
versions: python 3.12.1, nnpp-edge 0.1.0, numpy 2.0, numba 0.60, onnxruntime None
profile: edge-2core: soft
A*, ms: 256² 3.14 · 1024² 50
corridor, ms: –
nnpp int8, ms: –
nnpp fp32, ms: –
auto, ms: 256² 1 · 1024² 9
first path of a map, ms: 256² 4
verdict: met
others took: 3.4 %
throttled: no
"""


def test_a_report_as_a_row():
    head, _, row = board_table(REPORT).splitlines()
    told = map(": ".join, zip(cells_of(head), cells_of(row), strict=True))
    assert [*told] == ROW.strip().splitlines()
    nothing = {"sensors": {"throttled": "", "clock_mhz": {}, "temperature_c": {}}}
    told = board(REPORT | nothing)
    assert (told["throttled"], told["clock"]) == ("not told", "2400 MHz, not told while it ran")


def test_the_committed_table_has_these_columns_and_nothing_follows_it():
    text = BOARDS.read_text()
    header = board_table(REPORT).rpartition("\n")[0]
    before, _, after = text.partition(header + "\n")
    assert before != text, f"docs/boards.md must hold the header\n{header}"
    lines = after.splitlines()
    assert all(len(cells_of(line)) == len(board(REPORT)) for line in lines), (
        "nothing but rows follows the header"
    )
    assert text.endswith("\n")
    for line in lines:
        told = dict(zip(board(REPORT), cells_of(line), strict=True))
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", told["date"]) and all(told.values())
