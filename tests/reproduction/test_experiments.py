import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.suites import TerrainFiles
from nnpp_edge.reproduction import dynamic, runner
from nnpp_edge.reproduction.episode import make_episode
from nnpp_edge.reproduction.findings import Verdict
from nnpp_edge.reproduction.planners import (
    PLAIN,
    PLAIN_NN,
    PLANNERS,
    answers,
)
from nnpp_edge.reproduction.regions import Networks
from nnpp_edge.reproduction.rows import Rows
from nnpp_edge.reproduction.runner import EXPERIMENTS, reproduce
from nnpp_edge.runtime import NetworkModel
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.synthetic import synthetic_terrain

TINY = {
    "table1": {"sizes": (16, 32, 64, 512), "maps": 1},
    "fig7": {"size": 64, "maps": 3, "fine": 10, "coarse": 3},
    "table2": {"sizes": (64, 128), "maps": 4, "queries": 3, "repeats": 1},
    "fig9": {"sizes": (64, 96), "queries": 2, "repeats": 1},
    "fig11": {"size": 64, "queries": 4, "repeats": 1},
    "fig12": {"size": 64, "maps": 2, "repeats": 1},
    "fig14": {"size": 64, "goals": 3},
    "table3": {"size": 64, "episodes": 2, "repeats": 1},
    "table4": {"size": 64, "maps": 2, "repeats": 1},
}
"""What each experiment's quick settings are replaced by here."""


@pytest.fixture(autouse=True, scope="module")
def shrink():
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(runner, "exercise", lambda: None)  # nobody looks at the times
        for name, quick in TINY.items():
            monkeypatch.setitem(EXPERIMENTS, name, replace(EXPERIMENTS[name], quick=quick))
        yield


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("terrain") / "ground.npz"
    np.savez(
        path, elevation_m=synthetic_terrain(np.random.default_rng(4), 256, 5.0), cell_size_m=5.0
    )
    return path


@pytest.fixture(scope="module")
def run(tiny_model):
    """Run experiments on a terrain file into a folder; how each ended."""

    def run_on(terrain, folder, *names, models=(tiny_model, tiny_model), **more):
        files = TerrainFiles((terrain,))
        both = tuple(map(str, models))
        return list(reproduce(names or list(TINY), files, folder, models=both, quick=True, **more))

    return run_on


@pytest.fixture(scope="module")
def made(terrain, run, tmp_path_factory):
    """The output of a run of everything, as small as can be, and how each experiment ended."""
    folder = tmp_path_factory.mktemp("made") / "out"
    return folder, run(terrain, folder)


def tables(text):
    """The tables of a page: for each the number of columns of each line."""
    out = []
    lines = text.splitlines()
    for above, line in zip(["", *lines[:-1]], lines, strict=True):
        if line.startswith("|"):
            cells = len(line.strip("|").split("|"))
            out[-1].append(cells) if above.startswith("|") else out.append([cells])
    return out


def test_every_experiment_writes_its_tables_picture_and_findings(made, terrain):
    folder, outcomes = made
    assert {facts.name: ran for facts, ran in outcomes} == dict.fromkeys(TINY, True)
    index = (folder / "README.md").read_text()
    heads = {
        Verdict.AGREES: "What agrees",
        Verdict.BETTER: "What is better",
        Verdict.DIFFERS: "What does not agree",
    }
    for made_of, _ in outcomes:
        name = made_of.name
        files = {f"{name}.{end}" for end in ("csv", "png", "json")}
        assert {path.name for path in (folder / name).iterdir()} == files
        with (folder / name / f"{name}.csv").open() as file:
            header, *rows = csv.reader(file)
        assert (
            rows
            and len(set(header)) == len(header)
            and all(len(row) == len(header) for row in rows)
        ), name
        assert any(
            cell.replace(".", "").replace("e-", "").isdigit() for row in rows for cell in row
        )
        with Image.open(folder / name / f"{name}.png") as picture:
            assert (
                min(picture.size) > 300
                and len(set(picture.convert("L").resize((64, 64)).tobytes())) > 8
            ), name
        facts = json.loads((folder / name / f"{name}.json").read_text())
        assert facts["quick"] and facts["made_with"]["terrain"].startswith(
            "`ground.npz` (cells of 5 m, "
        )
        assert made_of.findings and f"{name}/{name}.png" in index
        for finding in made_of.findings:
            part = index.partition(heads[finding.verdict])[2].partition("\n## ")[0]
            assert finding.claim in part and finding.ours in part
    assert "Left out, as the terrain is no more than 256 cells a side: 512²." in index
    assert len(tables(index)) > len(TINY) and all(
        len(set(t)) == 1 and len(t) > 2 for t in tables(index)
    )
    assert str(terrain.parent) not in index and "None" not in index and "nan" not in index
    assert all(
        words in index for words in ("smoke run", "- networks: ", "- samples: ", "- controls: ")
    )


def test_every_page_of_a_network_names_it_and_has_controls(made):
    for name in ("table2", "fig9", "fig11", "fig12", "fig14", "table3", "table4"):
        text = (
            (made[0] / "README.md")
            .read_text()
            .partition(f'<a id="{name}">')[2]
            .partition("<a id")[0]
        )
        assert "`tiny`" in text and "corridor" in text, name
        lines = text.splitlines()
        assert all(
            "`tiny`" in line for line in lines if "| plain A*NN |" in line or "| `nnpp` |" in line
        ), name


def test_a_second_run_skips_what_is_complete_and_mends_what_is_not(
    terrain, run, tiny_model, tmp_path
):
    def ended(**more):
        return [ran for _, ran in run(terrain, tmp_path, "fig12", "table1", **more)]

    assert ended() == [True, True]
    first = (tmp_path / "fig12" / "fig12.json").stat().st_mtime_ns
    (tmp_path / "table1" / "table1.png").unlink()
    assert ended() == [False, True]
    assert (tmp_path / "fig12" / "fig12.json").stat().st_mtime_ns == first
    assert ended(again=True) == [True, True]
    assert ended(models=(tiny_model, "edge")) == [True, False], "Table 1 asks no network"
    assert ended(seed=2) == [True, True]
    assert {p.name for p in tmp_path.iterdir()} == {"fig12", "table1", "README.md"}


def test_an_experiment_that_fails_leaves_what_was_there(terrain, run, tmp_path, monkeypatch):
    run(terrain, tmp_path, "table1")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}

    def fails(context, **settings):
        raise InvalidQueryError("no such luck")

    monkeypatch.setitem(EXPERIMENTS, "table1", replace(EXPERIMENTS["table1"], run=fails))
    with pytest.raises(InvalidQueryError, match="no such luck"):
        run(terrain, tmp_path, "table1", again=True)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_plain_astar_is_optimal_and_the_region_is_the_networks(tiny_model):
    cost = np.random.default_rng(3).uniform(0.0, 0.8, (70, 70)).astype(np.float32)
    networks = Networks(NetworkModel(tiny_model), NetworkModel(tiny_model))
    timed, plain = (Rows(answers(cost, ((2, 3), (60, 66)), networks, n, Harness())) for n in (1, 0))
    assert [row["planner"] for row in timed] == list(PLANNERS)
    for rows in (timed, plain):
        (exact_row,), (nn,) = rows.of(PLAIN), rows.of(PLAIN_NN)
        assert exact_row["excess"] == pytest.approx(0.0, abs=1e-5) and "mm" not in exact_row
        assert nn["excess"] >= -1e-5 and 0.0 < nn["mm"] <= 1.0
        assert rows.increase(PLAIN) == pytest.approx(0.0, abs=1e-2)
    assert timed.of(PLAIN_NN).mean("excess") == pytest.approx(
        plain.of(PLAIN_NN).mean("excess"), abs=1e-5
    )
    assert 0.0 < timed.of(PLAIN_NN).mean("inference_s") < timed.of(PLAIN_NN).mean("time_s")
    assert not plain.all("time_s")


def test_an_episode_is_driven_by_all(tiny_model):
    cost = np.random.default_rng(3).uniform(0.0, 0.8, (96, 96)).astype(np.float32)
    networks = Networks(NetworkModel(tiny_model), NetworkModel(tiny_model))
    stride = dynamic.stride_on(96)
    episode = make_episode(cost, (5, 5), (90, 88), seed=2, stride=stride)
    rows = dynamic.drive(episode, networks, 1)
    assert len(episode.steps) > 2 and len(rows) == len(episode.steps) * len(dynamic.PLANNERS)
    for (_,), plan in rows.by("plan").items():
        assert plan.of(PLAIN).mean("excess") == pytest.approx(0.0, abs=1e-5)
        for name in ("astar", "dstar"):
            assert plan.increase(name) == pytest.approx(0.0, abs=1e-2), name
    assert rows.of("dstar").all("mended") == [0.0] + [1.0] * (len(episode.steps) - 1)


def test_the_command_prints_a_line_for_each_experiment_and_json_for_programs(
    nnpp_edge, terrain, tiny_model, tmp_path
):
    words = [
        "reproduce",
        "table1",
        "fig12",
        "--quick",
        "--terrain",
        terrain,
        "--model",
        tiny_model,
        "-o",
        tmp_path,
    ]
    ended = nnpp_edge(*words)
    assert ended.code == 0, ended.err
    first, second, last = ended.out.splitlines()
    assert (
        first.startswith("table1: ") and second.startswith("fig12: ") and last.endswith("README.md")
    )
    told = json.loads(nnpp_edge(*words, "--json").out)
    assert [(e["experiment"], e["ended"]) for e in told["experiments"]] == [
        ("table1", "skipped"),
        ("fig12", "skipped"),
    ]
    assert all(f["verdict"] in list(Verdict) for e in told["experiments"] for f in e["findings"])
