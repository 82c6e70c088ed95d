"""Experiments from the command to the page."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.profiling.suites import dems_of
from nnpp_edge.reproduction import dynamic, runner
from nnpp_edge.reproduction.findings import Verdict, judge_increase
from nnpp_edge.reproduction.planners import PLAIN, PLAIN_NN, PLANNERS
from nnpp_edge.reproduction.runner import EXPERIMENTS, reproduce
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.synthetic import synthetic_terrain

TINY = {
    "table1": {"sizes": (16, 32, 64, 512), "maps": 1},
    "fig7": {"size": 64, "maps": 3, "fine": 10, "coarse": 3},
    "table2": {"sizes": (64, 128), "maps": 4, "queries": 3, "repeats": 1},
    "fig9": {"sizes": (64, 96), "queries": 2, "repeats": 1},
    "fig11": {"sizes": (64,), "queries": 4, "repeats": 1},
    "fig12": {"sizes": (64,), "maps": 2, "repeats": 1},
    "fig14": {"size": 64, "goals": 3},
    "table3": {"size": 64, "episodes": 2, "repeats": 1},
    "table4": {"size": 64, "maps": 2, "repeats": 1},
}
"""Settings in place of each experiment's."""
BY = {
    **dict.fromkeys(("table2", "fig9", "fig11", "fig12"), PLANNERS),
    **dict.fromkeys(("table3", "table4"), dynamic.PLANNERS),
}
"""Planners whose answers an experiment's rows are."""
EXACT = (PLAIN, "astar", "dstar")
HEADS = {
    Verdict.AGREES: "## What agrees",
    Verdict.BETTER: "## What is better",
    Verdict.DIFFERS: "## What does not agree",
    Verdict.TOO_FEW: "## What too few queries were made for",
}


@pytest.fixture(autouse=True, scope="module")
def shrink():
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(runner, "exercise", lambda: None)  # no test reads the times
        monkeypatch.setattr(runner, "QUICK", {})
        for name, tiny in TINY.items():
            monkeypatch.setitem(EXPERIMENTS, name, replace(EXPERIMENTS[name], settings=tiny))
        yield


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("terrain") / "ground.npz"
    heights = synthetic_terrain(np.random.default_rng(4), 256, 5.0)
    np.savez(path, elevation_m=heights, cell_size_m=5.0)
    return path


@pytest.fixture(scope="module")
def run(terrain, tiny_model):
    """Run experiments into a folder; what is stored of each by name."""

    def run_into(folder, *names):
        models = (str(tiny_model), str(tiny_model))
        names = names or list(TINY)
        ended = reproduce(names, dems_of((terrain,)), folder, models=models, quick=True)
        return {stored.name: stored for stored in ended}

    return run_into


@pytest.fixture(scope="module")
def made(run, tmp_path_factory):
    """The folder of a run of everything, and what is stored of each experiment by name."""
    folder = tmp_path_factory.mktemp("made") / "out"
    return folder, run(folder)


@pytest.mark.parametrize("name", TINY)
def test_an_experiment_writes_its_figures_picture_and_findings(made, name):
    whole, stored = made
    folder = whole / name
    assert {path.suffix for path in folder.iterdir()} == {".csv", ".png", ".json"}
    with (folder / f"{name}.csv").open() as file:
        rows = [*csv.DictReader(file)]
    assert rows and None not in rows[0]
    answers = [row for row in rows if row.get("gap")]
    for row in answers:
        assert float(row["gap"]) >= -1e-5
        assert float(row["gap"]) <= 1e-5 or row["planner"] not in EXACT
    for row in answers:
        if row["planner"] == PLAIN_NN:
            assert 0.0 < float(row["mm"]) <= 1.0
            assert not row["time_s"] or 0.0 < float(row["inference_s"]) < float(row["time_s"])
    if by := BY.get(name):
        assert {row["planner"] for row in rows} == {*by}
        assert {row["found"] for row in rows} <= {"1.0", "0.0"}
    with Image.open(folder / f"{name}.png") as picture:
        assert min(picture.size) > 300
    facts = json.loads((folder / f"{name}.json").read_text())
    assert facts["quick"]
    assert facts["made_with"]["terrain"].startswith("`ground.npz` (cells of 5 m, ")
    assert stored[name].findings
    page = (whole / "README.md").read_text()
    for finding in stored[name].findings:
        part = page.partition(HEADS[finding.verdict])[2].partition("\n## ")[0]
        assert finding.claim in part and finding.ours in part
    section = page.partition(f'<a id="{name}">')[2].partition("<a id")[0]
    for words in (f"]({name}/{name}.png)", "- networks: ", "- samples: ", "- controls: "):
        assert words in section
    networks = EXPERIMENTS[name].networks
    assert all(word in section for word in ("corridor", "`tiny`") if networks)


def test_too_few_queries_for_a_verdict_are_said_to_be_too_few_with_an_interval():
    """Five queries, of which one has most of the cost: without it the claim holds."""

    def found(increases):
        rows = Rows(
            {"planner": "nnpp", "map": at, "cc": 1.0 + share, "exact_cc": 1.0}
            for at, share in enumerate(increases)
        )
        return judge_increase("CC", 0.03, rows, "nnpp")

    few = found([0.01, 0.01, 0.01, 0.01, 0.15])
    assert few.verdict is Verdict.TOO_FEW
    assert few.ours == "3.80 % (1.00 % to 9.40 %)"
    assert found([0.01] * 5).verdict is Verdict.BETTER
    assert found([0.2] * 5).verdict is Verdict.DIFFERS


def test_the_page_has_whole_tables_and_says_what_is_left_out(made, terrain):
    page = (made[0] / "README.md").read_text()
    assert "smoke run" in page
    assert "Left out, as the terrain is no more than 256 cells a side: 512²." in page
    for words in (str(terrain.parent), "None", "nan"):
        assert words not in page
    tables = [part for part in page.split("\n\n") if part.startswith("|")]
    widths = [{line.count("|") for line in table.splitlines()} for table in tables]
    assert len(tables) > len(TINY)
    assert all(len(width) == 1 for width in widths)


def test_another_run_leaves_what_is_there_on_the_page(nnpp_edge, made, terrain, tiny_model):
    folder, _ = made
    words = ("--quick", "--terrain", terrain, "--model", tiny_model, "-o", folder)
    before = (folder / "README.md").read_text()
    ended = nnpp_edge("reproduce", "table1", "--seed", 2, *words)
    assert ended.code == 0, ended.err
    first, last = ended.out.splitlines()
    assert first.startswith("table1: ") and last.endswith("README.md")
    after = (folder / "README.md").read_text()
    assert "seed 2" in after and "seed 2" not in before
    assert after.partition('<a id="fig7">')[2] == before.partition('<a id="fig7">')[2] != ""


def test_an_experiment_that_fails_leaves_what_was_there(made, run, monkeypatch):
    folder, _ = made

    def contents():
        return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def fails(context, **settings):
        raise InvalidQueryError("no such luck")

    before = contents()
    monkeypatch.setitem(EXPERIMENTS, "table1", replace(EXPERIMENTS["table1"], measure=fails))
    with pytest.raises(InvalidQueryError, match="no such luck"):
        run(folder, "table1")
    assert contents() == before
