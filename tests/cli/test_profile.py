"""`nnpp-edge profile`: a report in every form, what makes one noisy, and two of them compared."""

import json
import math
import os
import sys
from contextlib import ExitStack, nullcontext
from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.profiling import judge, machine, measure
from nnpp_edge.profiling import report as report_module
from nnpp_edge.profiling.processes import peak_memory_mb
from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime import Ground, Vehicle
from tests.cli.grounds import written
from tests.profiling.test_profile_machine import busy_core
from tests.tables import cases

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
terrain = ["synthetic"]
workloads = ["soft", "limit20"]
sizes = [64]
queries = 10
repeats = 1
[model]
int8 = "MODEL"
fp32 = "MODEL"
"""


CORE = min(os.sched_getaffinity(0))
KEYS = """
schema version made profile verdict summary budgets results loop disturbance sensors besides
cores environment notes
"""
DESCRIBED = Path(__file__).parents[2].joinpath("docs", "reference", "figures.md").read_text()
ARRIVALS = """
  { name = "first path", quantity = "map_ms", limit = 1e6, direction = "at most", unit = "ms" },
  { name = "late", planner = "astar", quantity = "patch_ms_p99", limit = 1e-6, direction = "at most", unit = "ms" },
  { name = "fresh", quantity = "speedup_map", limit = 1e-6, direction = "at least", unit = "x" },
  { name = "reaction", quantity = "reaction_ms", limit = 1e6, direction = "at most", unit = "ms", workload = "soft" },
]
"""
ALONE = {'["soft", "limit20"]': '["soft"]'}
LONGER = {"sizes = [64]": "sizes = [192]", "repeats = 1": "repeats = 4", **ALONE}
"""Changes for a run that is long enough for a disturbance to show."""


@pytest.fixture
def profile(run, tiny_model, monkeypatch):
    """Write tiny.toml, which stands any noise unless told otherwise; peak memory has a test of its
    own.
    """
    monkeypatch.setattr(report_module, "peak_memory_mb", lambda *words: 100.0)
    monkeypatch.setattr(judge, "MOST_APART", 1000.0)

    def write(limit=1.0, disturbance=1.0, changes=()):
        text = (
            PROFILE.replace("LIMIT", str(limit))
            .replace("CORE", str(CORE))
            .replace("MODEL", str(tiny_model))
        )
        monkeypatch.setattr(judge, "MOST_DISTURBED", disturbance)
        for old, new in dict(changes).items():
            assert old in text
            text = text.replace(old, new)
        Path("tiny.toml").write_text(text)

    return write


def described(*tables):
    """Every key of a report has its line in docs/reference/figures.md."""
    for key in set().union(*tables):
        assert f"`{key}`" in DESCRIBED, key


def test_a_report_in_every_form(run, profile):
    before = os.sched_getaffinity(0)
    profile()
    ended = run("profile --profile tiny.toml -o out --junit ci/budgets.xml")
    assert ended.code == 0, ended.err
    assert os.sched_getaffinity(0) == before
    for words in (
        "speed-up",
        "inference",
        "all budgets met: 5 kept",
    ):
        assert words in ended.out
    told = written("out/report.json")
    assert set(told) == set(KEYS.split()) and told["schema"] == 1 and told["verdict"] == "met"
    described(
        KEYS.split(), told["budgets"][0], told["results"][0], told["disturbance"]["halves"][0]
    )
    described(told["sensors"])
    page = Path("out/report.html").read_text()
    assert "Tiny &amp; &lt;quick&gt;" in page and "Tiny & <quick>" not in page
    assert page.count('src="data:image/png;base64,iVBORw0KGgo') == 1
    assert "<script" not in page and 'src="http' not in page and "@import" not in page
    assert not Path("out/.report.json").exists() and len(list(Path("out").iterdir())) == 3
    again = run("profile render out/report.json -o again/page.html")
    assert (again.code, again.out) == (0, "again/page.html\n")
    assert Path("again/page.html").read_text() == page
    assert run("profile render out/report.json -o again").out == "again/report.html\n"
    assert Path("ci/budgets.xml").read_bytes().count(b"<testcase") == 5


def test_the_clock_starts_at_the_elevations(run, profile):
    profile(changes={"]\n[device]": f"{ARRIVALS}[loop]\nrate_hz = 200.0\n[device]"})
    ended = run("profile --profile tiny.toml -o .")
    assert ended.code == 1, ended.err
    told = written("report.json")
    text = Path("report.md").read_text()
    lines = [
        f"{line['name']} {line['planner']} {line['workload']} {line['verdict']}"
        for line in told["budgets"][-7:]
    ]
    assert lines == [
        *("first path nnpp soft pass", "first path nnpp limit20 pass"),
        *("late astar soft fail", "late astar limit20 fail"),
        *("fresh nnpp soft pass", "fresh nnpp limit20 pass", "reaction loop soft pass"),
    ]
    (row,) = told["loop"]
    assert (row["rate_hz"], row["patch_side"]) == (200.0, 16)
    assert row["n"] == row["planned"] + row["kept"] + row["without_path"] == 240
    assert row["planned"] > 0 and len(row["halves"]["reaction"]) == 2
    assert 0.0 < row["reaction_ms"]["median"] <= row["reaction_ms"]["p99"]
    described(row)
    assert text.startswith("# Tiny & <quick>\n\nbudgets missed: ")
    assert "from a patch's arrival to the checked path\n\n| workload |" in text
    for row in told["results"]:
        asked = row["planner"] in ("nnpp", "astar")
        of_maps = {"map_ms": "map", "patch_ms": "patch", "speedup_map": "map_ratio"}
        for key, basis in of_maps.items():
            assert (row[key] is not None) == (basis in row["halves"]) == asked
        assert (row["speedup_map"] == 1.0) == (row["planner"] == "astar")
        del row["map_ms"]
    Path("older.json").write_text(json.dumps(told))
    assert run("profile compare older.json report.json").code == 0


def test_json_may_be_printed_and_an_impossible_budget_is_missed_and_named(run, profile):
    profile(limit=1e7)
    ended = run("profile --profile tiny.toml --queries 4 --seed 5 --json")
    told = ended.json
    load = told["profile"]["load"]
    assert (ended.code, load["queries"], load["seed"]) == (
        1,
        4,
        5,
    ) and "profile: 100 %" in ended.err
    assert {row["n"] for row in told["results"]} == {4}
    assert told["summary"].startswith(
        "budgets missed: 3 kept, 2 missed; missed: plans a second (nnpp, soft 64², limit20 64²)"
    )


def test_a_run_disturbed_in_one_half_is_noisy(told, profile, monkeypatch):
    """Another process on the one core in the second half, and a kernel that counts no core's time:
    the planners stand still, and nothing may pass by a small margin.
    """
    monkeypatch.setattr(machine, "core_seconds", lambda cores: None)
    monkeypatch.setattr(judge, "_TEN_TIMES", math.inf)
    with ExitStack() as disturbances:
        halves = iter((nullcontext(), busy_core(CORE)))

        def solvable(*words, real=measure.solvable):
            disturbances.enter_context(next(halves))
            return real(*words)

        monkeypatch.setattr(measure, "solvable", solvable)
        profile(disturbance=0.1, changes=LONGER)
        report = told("profile --profile tiny.toml", code=3)
    assert report["verdict"] == "noisy"
    assert [line["verdict"] for line in report["budgets"]] == ["noisy", "pass", "pass"]
    half = report["disturbance"]["halves"][1]
    assert half["others_share"] is None and half["waited_share"] > 0.1


def test_what_is_no_report_is_refused(run):
    damaged = '{"schema": 1, "results": [{}]}'
    others = ("", "[]", "{}", "[" * 100_000, '{"schema": 2, "results": []}', '{"schema": 1}')
    for content in (*others, damaged):
        Path("other.json").write_text(content)
        for words in ("compare other.json", "render -o new.html"):
            run(f"profile {words} other.json").refused("wanted", "nnpp-edge profile")
    assert [each.name for each in Path().iterdir()] == ["other.json"]


def test_the_page_alone_needs_the_extra_viz(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    report = Path(__file__).parents[1] / "profiling" / "report.json"
    run(f"profile render {report} -o page.html").refused("jinja2: pip install")


COMPARED = """
same | 1.0 | {} | 0 | all budgets met: 13 kept
slower | 1.3 | {} | 1 | missed: time_ms_median (nnpp, soft 256²)
disturbed | 2.0 | {"disturbance": {"halves": [{"waited_share": 0.0, "others_share": 0.4}]}} | 3 | others took 40 %
another | 1.0 | {"environment": {"cpu": "another"}} | 0 | other CPU
"""
"""Times as slow, other facts, the exit code, and words of the comparison."""


@pytest.mark.parametrize(("name", "factor", "facts", "code", "words"), cases(COMPARED, 5))
def test_two_reports_are_compared(run, told, monkeypatch, name, factor, facts, code, words):
    monkeypatch.setattr(judge, "MOST_APART", 1000.0)
    report = written(Path(__file__).parents[1] / "profiling" / "report.json")
    report["disturbance"]["halves"] = [{"waited_share": 0.0, "others_share": None}]
    Path("report.json").write_text(json.dumps(report))
    other = report | {key: report[key] | changed for key, changed in json.loads(facts).items()}
    other["results"][1]["time_ms"]["median"] *= float(factor)
    Path("other.json").write_text(json.dumps(other))
    ended = run("profile compare report.json other.json")
    assert ended.code == int(code) and words in ended.out
    tolerant = run("profile compare report.json other.json --tolerance 1.5").code
    assert tolerant == (0 if code == "1" else int(code))
    found = told("profile compare report.json other.json", code=int(code))
    missed = {line["planner"] for line in found["budgets"] if line["verdict"] == "fail"}
    assert missed == ({"nnpp"} if code == "1" else set())


def test_peak_memory_is_that_of_another_process_on_the_map_that_the_planner_takes(tiny_model):
    """A body's planner takes heights: costs alone take 9 bytes a cell."""
    query = ((5, 5), (90, 90))

    def peak(side, vehicle=None):
        flat = np.zeros((side, side), np.float32)
        ground = Ground.of_elevation(flat, 0.25, vehicle=vehicle)
        on_map = Case("soft", side, flat + 0.2, (query,), ground)
        return peak_memory_mb(on_map, "astar", str(tiny_model))

    mine = np.ones(200_000_000, np.uint8)  # must not count
    small = peak(96)
    with_body = peak(2400, Vehicle(1.0, 0.8, 0.3))
    assert mine.nbytes == 200_000_000
    assert 30.0 < small < 0.9 * with_body
    assert with_body - small > 1e-6 * 2400 * 2400 * 12


def test_start_up_is_measured_where_a_budget_asks_for_it(told, profile, tiny_model, monkeypatch):
    asked = []

    def measured(*words):
        asked.append(words)
        return 0.5

    monkeypatch.setattr(report_module, "start_up_s", measured)
    monkeypatch.setattr(report_module, "first_tick_s", measured)
    for quantity, of, words in (
        ("start_up_warm_s", "nnpp", ("nnpp", str(tiny_model))),
        ("first_tick_warm_s", "loop", ("auto",)),
    ):
        budget = (
            f'{{ name = "b", quantity = "{quantity}", limit = 1, '
            'direction = "at most", unit = "s" },'
        )
        profile(changes={"]\n[device]": f"{budget}\n]\n[device]", **ALONE})
        found = told("profile --profile tiny.toml")
        assert asked.pop() == words and not asked
        assert found["besides"][quantity] == {of: 0.5}
        assert (found["budgets"][-1]["verdict"], found["budgets"][-1]["planner"]) == ("pass", of)


def test_terrain_smaller_than_what_is_measured_is_told(run, told, profile):
    profile()
    np.savez("small.npz", elevation_m=np.zeros((70, 80), np.float32), cell_size_m=0.1)
    words = "profile --profile tiny.toml --terrain small.npz --sizes"
    run(f"{words} 128,96").refused(
        "small.npz: wanted terrain of at least 96 × 96 cells, got 70 × 80: --sizes 70 is the "
        "largest that fits"
    )
    found = told(f"{words} 64,96")
    assert {row["size"]: row["terrain"] for row in found["results"]} == {
        64: "small",
        96: "synthetic",
    }
    assert "no terrain has 96 × 96 cells: synthetic ground in its place" in found["notes"]
