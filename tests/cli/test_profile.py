import json
import os
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.profiling import report as report_module
from nnpp_edge.profiling.board import board_row
from nnpp_edge.profiling.cold_start import ColdStart
from tests.profiling.traces import check_trace, spans_of, within

PROFILE = """
title = "Tiny & <quick>"
planner = "nnpp"
budgets = [
  { name = "plans a second", quantity = "fps", limit = LIMIT, direction = "at least", unit = "1/s" },
  { name = "answered", quantity = "success", limit = 100.0, direction = "at least", unit = "%" },
  { name = "model", quantity = "model_mb", limit = 1.0, direction = "at most", unit = "MB" },
]
[device]
cores = [CORE]
threads = 1
[workload]
terrain = "synthetic"
workloads = ["soft", "limit20"]
sizes = [64]
queries = 10
near = 6
repeats = 1
[model]
int8 = "MODEL"
fp32 = "MODEL"
[stability]
halves = 1000.0
disturbance = DISTURBANCE
"""


@pytest.fixture
def core():
    return min(os.sched_getaffinity(0))


@pytest.fixture
def profile(tmp_path, tiny_model, core, monkeypatch):
    """Write a profile that stands any noise, unless told otherwise; peak memory has a test of its own."""
    monkeypatch.setattr(report_module, "peak_memory_mb", lambda *words: 100.0)

    def write(limit=1.0, disturbance=1.0, **changes):
        text = PROFILE.replace("LIMIT", str(limit)).replace("CORE", str(core)).replace("MODEL", str(tiny_model))
        text = text.replace("DISTURBANCE", str(disturbance))
        for old, new in changes.items():
            text = text.replace(old, new)
        (tmp_path / "tiny.toml").write_text(text)
        return tmp_path / "tiny.toml"

    return write


KEYS = """
schema version made profile verdict summary budgets results loop break_even disturbance contention sensors besides
profiler_peak_memory_mb energy_problem cores environment notes
"""
DESCRIBED = Path(__file__).parents[2].joinpath("docs", "profile.md").read_text()


def described(*tables):
    """Every key of a report has its line in docs/profile.md."""
    for key in set().union(*tables):
        assert f"`{key}`" in DESCRIBED, key


def test_a_report_in_every_form(nnpp_edge, profile, tmp_path):
    files = [tmp_path / "out" / name for name in ("report.json", "report.html")]
    before = os.sched_getaffinity(0)
    ended = nnpp_edge("profile", "--profile", profile(), "-o", tmp_path / "out")
    assert ended.code == 0, ended.err
    assert os.sched_getaffinity(0) == before
    for words in ("speed-up", "inference", "corridor pays over astar", "all budgets met: 5 of 5 pass"):
        assert words in ended.out
    told = json.loads(files[0].read_text())
    assert set(told) == set(KEYS.split()) and told["schema"] == 1 and told["verdict"] == "met"
    described(KEYS.split(), told["budgets"][0], told["results"][0], told["disturbance"]["halves"][0])
    page = files[1].read_text()
    assert "Tiny &amp; &lt;quick&gt;" in page and "Tiny & <quick>" not in page
    assert page.count("<svg") == 5 and page.count("data:image/png;base64,") == 3
    assert "<script" not in page and 'src="http' not in page and "@import" not in page
    assert "#010203" not in page and "currentColor" in page
    assert not (tmp_path / "out" / ".report.json").exists() and len(list((tmp_path / "out").iterdir())) == 5


def test_a_row_for_the_table_of_boards_a_trace_and_the_same_beside_other_work(nnpp_edge, profile, tmp_path, core):
    contention = f"[contention]\nthreads = 1\ncores = [{core}]\n[stability]"
    changes = {"[stability]": contention, '["soft", "limit20"]': '["soft"]'}
    ended = nnpp_edge("profile", "--profile", profile(**changes), "-o", tmp_path)
    assert ended.code == 0, ended.err
    told = json.loads((tmp_path / "report.json").read_text())
    *_, row = (tmp_path / "board-row.md").read_text().splitlines()
    assert row == board_row(told) and row.startswith(f"| {told['made'][:10]} | ")
    assert told["contention"]["beside"] == "1 busy thread"
    rows = told["contention"]["rows"]
    assert [each["planner"] for each in rows] == [each["planner"] for each in told["results"]]
    assert rows[0]["idle_ms"] == told["results"][0]["time_ms"]
    assert max(half["waited_share"] for half in told["contention"]["halves"]) > 0.2
    assert "Beside other work" in (tmp_path / "report.html").read_text()
    described(told["contention"], rows[0], told["sensors"])
    spans = check_trace((tmp_path / "trace.json").read_bytes())
    on_map = spans_of(spans, "soft 64², half ")
    inside = [each for whole in on_map for each in within(spans, whole)]
    calls = [each for each in inside if each["name"] == "nnpp"]
    assert len(calls) == 2 * 16, "each query once in each half"
    stages = [within(inside, call) for call in calls]
    assert all([each["name"] for each in of_call][-2:] == ["search", "path"] for of_call in stages)
    whole = ["encode", "inference", "threshold", "search", "path"]
    assert whole in [[each["name"] for each in of_call] for of_call in stages]
    for call, of_call in zip(calls, stages, strict=True):
        assert sum(each["dur"] for each in of_call) > 0.3 * call["dur"]


ARRIVALS = """
  { name = "first path", quantity = "map_ms", limit = 1e6, direction = "at most", unit = "ms" },
  { name = "late", planner = "astar", quantity = "patch_ms_p99", limit = 1e-6, direction = "at most", unit = "ms" },
  { name = "reaction", quantity = "reaction_ms", limit = 1e6, direction = "at most", unit = "ms", workload = "soft" },
]
"""


def test_the_clock_starts_at_the_elevations(nnpp_edge, profile, tmp_path):
    changes = {"]\n[device]": f"{ARRIVALS}[loop]\nrate_hz = 200.0\n[device]"}
    ended = nnpp_edge("profile", "--profile", profile(**changes), "-o", tmp_path, "--markdown")
    assert ended.code == 1, ended.err
    told = json.loads((tmp_path / "report.json").read_text())
    assert (tmp_path / "report.md").read_text() == ended.out
    lines = [(line["name"], line["planner"], line["workload"], line["verdict"]) for line in told["budgets"][-5:]]
    assert lines == [
        ("first path", "nnpp", "soft", "pass"),
        ("first path", "nnpp", "limit20", "pass"),
        ("late", "astar", "soft", "fail"),
        ("late", "astar", "limit20", "fail"),
        ("reaction", "loop", "soft", "pass"),
    ]
    assert all((row["map_ms"] is not None) == (row["planner"] in ("nnpp", "astar")) for row in told["results"])
    (row,) = told["loop"]
    assert (row["workload"], row["size"], row["rate_hz"], row["patch_side"]) == ("soft", 64, 200.0, 16)
    assert row["n"] == row["planned"] + row["kept"] + row["without_path"] == 240
    described(row)
    assert ended.out.startswith("# Tiny & <quick>\n\nbudgets missed: ")
    assert "## The onboard loop: from a patch's arrival to the checked path\n\n| workload |" in ended.out
    older = told | {"results": [{k: v for k, v in r.items() if k != "map_ms"} for r in told["results"]]}
    (tmp_path / "older.json").write_text(json.dumps(older))
    assert nnpp_edge("profile", "compare", tmp_path / "older.json", tmp_path / "report.json").code == 0


def test_json_may_be_printed(nnpp_edge, profile):
    ended = nnpp_edge("profile", "--profile", profile(), "--queries", 4, "--seed", 5, "--json")
    told = json.loads(ended.out)
    assert ended.code == 0 and told["profile"]["load"]["queries"] == 4 and told["profile"]["load"]["seed"] == 5
    assert {row["n"] for row in told["results"]} == {4}
    assert "profile: 100 %" in ended.err


def test_an_impossible_budget_is_missed_and_named(nnpp_edge, profile):
    ended = nnpp_edge("profile", "--profile", profile(limit=1e7))
    assert ended.code == 1
    assert ended.out.splitlines()[-1].startswith("budgets missed: 3 of 5 pass; not plans a second (soft 64²")


@contextmanager
def busy_core(core):
    """Another process that keeps a core busy."""
    code = f"import os\nos.sched_setaffinity(0, [{core}])\nprint(flush=True)\nwhile True: pass"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        try:
            process.stdout.readline()
            yield
        finally:
            process.kill()


LONGER = {"sizes = [64]": "sizes = [192]", "repeats = 1": "repeats = 4", '["soft", "limit20"]': '["soft"]'}
"""Changes for a run that is long enough for a disturbance to show."""


def test_a_disturbed_run_is_noisy(nnpp_edge, profile, core):
    """Another process on the one core, all the time: the halves agree, and yet nothing may pass."""
    with busy_core(core):
        ended = nnpp_edge("profile", "--profile", profile(disturbance=0.1, **LONGER), "--json")
    assert ended.code == 3, ended.out
    told = json.loads(ended.out)
    assert told["verdict"] == "noisy" and told["disturbance"]["words"]
    assert [line["verdict"] for line in told["budgets"]] == ["noisy", "pass", "pass"]
    assert max(half["waited_share"] for half in told["disturbance"]["halves"]) > 0.1
    assert "before the run begins" in ended.err


def test_a_run_disturbed_in_one_half_is_noisy(nnpp_edge, profile, core, monkeypatch):
    """The same with a kernel that counts no core's time: the planners stand still."""
    from nnpp_edge.profiling import machine, measure

    monkeypatch.setattr(machine, "core_seconds", lambda cores: None)
    with ExitStack() as disturbances:

        def first_half_again(*words, real=measure.first_half_again):
            disturbances.enter_context(busy_core(core))
            return real(*words)

        monkeypatch.setattr(measure, "first_half_again", first_half_again)
        ended = nnpp_edge("profile", "--profile", profile(disturbance=0.1, **LONGER), "--json")
    told = json.loads(ended.out)
    assert ended.code == 3 and told["verdict"] == "noisy"
    halves = told["disturbance"]["halves"]
    assert halves[1]["others_share"] is None and halves[1]["waited_share"] > 0.1


def test_what_makes_no_sense_ends_in_one_line(nnpp_edge, profile, tmp_path):
    for old, new, *words in (
        ('unit = "1/s"', 'unit = "FPS"', "budgets[0].unit", "'1/s'", "'FPS'"),
        ("queries = 10", "querys = 10", "workload.querys is unknown"),
        ('terrain = "synthetic"', 'terrain = "none.tif"', "none.tif"),
    ):
        file = profile()
        assert old in file.read_text()
        file.write_text(file.read_text().replace(old, new))
        nnpp_edge("profile", "--profile", file).refused(*words)
    for words in (
        "--profile quick --peers",
        "--profile quick --limit 3",
        "--peers --start-up",
        "--profile quick --json --markdown",
        "--queries 5 compare a.json b.json",
        "",
    ):
        ended = nnpp_edge("profile", *words.split())
        assert ended.code == 2 and "error: " in ended.err
    nnpp_edge("profile", "--profile", "slow").refused("'slow'", "quick")
    for content in ("", "[]", "{}", '{"schema": 2, "results": []}', '{"schema": 1}'):
        (tmp_path / "other.json").write_text(content)
        both = (tmp_path / "other.json",) * 2
        nnpp_edge("profile", "compare", *both).refused("other.json", "wanted a report of nnpp-edge profile")


def changed(told, path, **changes):
    for row in told["results"]:
        if row["planner"] == "nnpp":
            for key, factor in changes.items():
                if key == "time_ms":
                    row[key] = {name: factor * value for name, value in row[key].items()}
                else:
                    row[key] = factor * row[key] if factor > 0 else 0.5
    path.write_text(json.dumps(told))
    return path


def test_regressions_between_two_reports(nnpp_edge, profile, tmp_path):
    first = tmp_path / "report.json"
    assert nnpp_edge("profile", "--profile", profile(), "-o", tmp_path).code == 0
    read = lambda: json.loads(first.read_text())  # noqa: E731
    same = nnpp_edge("profile", "compare", first, first)
    assert same.code == 0 and same.out.startswith("0 of ")
    slower = changed(read(), tmp_path / "slower.json", time_ms=1.3, speedup_total=1 / 1.3)
    ended = nnpp_edge("profile", "compare", first, slower)
    assert ended.code == 1 and "time_ms median" in ended.out and "+30.0 %" in ended.out and "WORSE" in ended.out
    assert nnpp_edge("profile", "compare", first, slower, "--tolerance", 0.4).code == 0
    assert nnpp_edge("profile", "compare", slower, first).code == 0
    told = json.loads(nnpp_edge("profile", "compare", first, slower, "--json").out)
    worse = [line for line in told["lines"] if line["verdict"] == "worse"]
    assert {line["planner"] for line in worse} == {"nnpp"} and told["verdict"] == "worse"
    assert all(line["change"] == pytest.approx(0.3) for line in worse)
    failing = changed(read(), tmp_path / "failing.json", success=-1.0)
    assert nnpp_edge("profile", "compare", first, failing, "--tolerance", 0.4).code == 1
    disturbed = read()
    disturbed["disturbance"]["words"] = "others took 50 % of the cores' time"
    noisy = nnpp_edge("profile", "compare", first, changed(disturbed, tmp_path / "noisy.json", time_ms=2.0))
    assert noisy.code == 3 and "disturbed" in noisy.out
    elsewhere = read()
    elsewhere["environment"]["cpu"] = "another"
    ended = nnpp_edge("profile", "compare", first, changed(elsewhere, tmp_path / "elsewhere.json"))
    assert ended.code == 0 and "the CPU differs" in ended.out


def test_peak_memory_is_that_of_another_process(tiny_model):
    from nnpp_edge.profiling.memory import peak_memory_mb
    from nnpp_edge.profiling.profile_maps import ProfileMap, ProfileQuery
    from nnpp_edge.runtime import Ground, Vehicle

    query = ProfileQuery((5, 5), (90, 90), True)

    def peak(side, vehicle=None):
        flat = np.zeros((side, side), np.float32)
        on_map = ProfileMap("flat", flat + 0.2, Ground.of_elevation(flat, 0.25, vehicle=vehicle), (query,))
        return peak_memory_mb(on_map, query, "astar", str(tiny_model))

    mine = np.ones(200_000_000, np.uint8)  # must not count
    small, large, with_body = peak(96), peak(2400), peak(2400, Vehicle(1.0, 0.8, 0.3))
    assert mine.nbytes == 200_000_000
    assert 30.0 < small < 0.9 * large
    assert large - small > 1e-6 * 2400 * 2400 * 7  # costs and weights, less what either finds freed before
    assert with_body - small > 1e-6 * 2400 * 2400 * 8  # heights, and codes where it looked


def test_start_up_is_measured_where_a_budget_asks_for_it(nnpp_edge, profile, monkeypatch):
    asked = []

    def cold_start(method):
        asked.append(method)
        return ColdStart(5.0, 0.5, 0.1)

    monkeypatch.setattr(report_module, "cold_start", cold_start)
    budget = '{ name = "first plan", quantity = "start_up_warm_s", limit = 1, direction = "at most", unit = "s" },'
    file = profile(**{"]\n[device]": f"{budget}\n]\n[device]"})
    ended = nnpp_edge("profile", "--profile", file, "--json")
    told = json.loads(ended.out)
    assert asked == ["nnpp"] and told["besides"]["start_up_warm_s"] == {"nnpp": 0.5}
    assert told["budgets"][-1]["verdict"] == "pass"
    assert nnpp_edge("profile", "--profile", profile(), "--start-up").code == 0
    assert asked[1:] == ["astar", "corridor", "nnpp", "auto"]


def test_terrain_smaller_than_what_is_measured_is_told(nnpp_edge, profile, tmp_path):
    np.savez(tmp_path / "small.npz", elevation_m=np.zeros((70, 80), np.float32), cell_size_m=0.1)
    words = ("profile", "--profile", profile(), "--terrain", tmp_path / "small.npz", "--sizes")
    nnpp_edge(*words, "128,96").refused(
        "small.npz: wanted at least 96 × 96 cells, the size to be measured, got 70 × 80; --sizes 70 measures on it"
    )
    ended = nnpp_edge(*words, "64,96", "--json")
    told = json.loads(ended.out)
    assert {row["size"]: row["terrain"] for row in told["results"]} == {64: "small", 96: "synthetic"}
    assert "no terrain has 96 × 96 cells: synthetic ground in its place" in told["notes"]
