import csv
import io
import json
import shutil
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module

import cv2
import numpy as np
import pytest
from PIL import Image, ImageSequence

from nnpp_edge.benchmarks.dynamic_episode import make_episode
from nnpp_edge.profiling.suites import Case, TerrainFiles
from nnpp_edge.reproduction import experiment, fig7, fig13, paper, runner, table1, table2, table3, table4
from nnpp_edge.reproduction.animation import animate, view_episode
from nnpp_edge.reproduction.animation import driven as driven_way
from nnpp_edge.reproduction.contest import (
    PLAIN,
    PLAIN_CONTROLS,
    PLAIN_NN,
    PLANNERS,
    Answer,
    Means,
    Round,
    contest,
    means,
)
from nnpp_edge.reproduction.dynamic_contest import (
    CONTROL_OF,
    PLAIN_DSTAR,
    PLAIN_DSTAR_NN,
    Drive,
    drive,
    mended,
    stride_on,
)
from nnpp_edge.reproduction.regions import CONTROLS, CORRIDOR, NETWORK, Networks, RegionMeans
from nnpp_edge.reproduction.report import Table, Verdict, findings_table
from nnpp_edge.reproduction.runner import Request, reproduce
from nnpp_edge.runtime import NetworkModel
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.dataset import make_dataset, read_samples
from nnpp_edge.terrain.dem import read_dem
from nnpp_edge.terrain.shards import Recipe
from nnpp_edge.terrain.synthetic import synthetic_terrain

TINY = {
    "table1": {"sizes": (16, 32, 64, 512), "maps": 1, "repeats": 1},
    "fig6": {"size": 64},
    "fig7": {"size": 64, "maps": 3, "fine": 10, "coarse": 3},
    "fig8": {"size": 64},
    "table2": {"sizes": (64, 128), "maps": 4, "queries": 3, "repeats": 1},
    "fig9": {"sizes": (64, 96), "queries": 2, "repeats": 1},
    "fig11": {"size": 64, "queries": 4, "repeats": 1},
    "fig12": {"size": 64, "maps": 2, "repeats": 1},
    "fig14": {"size": 64, "goals": 3},
    "table3": {"size": 64, "episodes": 2, "cells_a_frame": 20},
    "table4": {"size": 64, "maps": 2},
    "fig13": {"steps": 1, "batch": 4, "maps": 3, "validation_maps": 2},
}
"""What each experiment's quick settings are replaced by here."""


@contextmanager
def no_bar(what, total):
    yield lambda done: None


def shrink(monkeypatch):
    monkeypatch.setattr(runner, "exercise", lambda: None)  # nobody looks at the times
    for name in TINY:
        module = import_module(f"nnpp_edge.reproduction.{name}")
        found = module.EXPERIMENT
        monkeypatch.setattr(module, "EXPERIMENT", replace(found, quick=replace(found.quick, **TINY[name])))


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("terrain") / "ground.npz"
    np.savez(path, elevation_m=synthetic_terrain(np.random.default_rng(4), 256, 5.0), cell_size_m=5.0)
    return path


@pytest.fixture(scope="module")
def made(terrain, tiny_model, tmp_path_factory):
    """The output of a run of everything, as small as can be, and how each experiment ended."""
    folder = tmp_path_factory.mktemp("made") / "out"
    with pytest.MonkeyPatch.context() as monkeypatch:
        shrink(monkeypatch)
        outcomes = list(
            reproduce(
                Request(list(TINY), TerrainFiles((terrain,)), folder, models=(str(tiny_model),) * 2, quick=True),
                bar=no_bar,
            )
        )
    return folder, outcomes


@pytest.mark.parametrize("name", TINY)
def test_every_experiment_writes_its_tables_picture_and_findings(made, name):
    folder, outcomes = made
    assert {o.name: o.how for o in outcomes}[name] == "done"
    endings = {"csv", "md", "png", "json"} | ({"gif"} if name == "table3" else set())
    assert {p.name for p in (folder / name).iterdir()} == {f"{name}.{end}" for end in endings}
    with (folder / name / f"{name}.csv").open() as file:
        header, *rows = csv.reader(file)
    assert rows and len(set(header)) == len(header) and all(len(row) == len(header) for row in rows)
    assert any(cell.replace(".", "").replace("e-", "").isdigit() for row in rows for cell in row)
    picture = cv2.imread(str(folder / name / f"{name}.png"))
    assert min(picture.shape[:2]) > 300 and picture.std() > 5
    facts = json.loads((folder / name / f"{name}.json").read_text())
    assert (
        facts["findings"] and facts["made_with"]["quick"] and facts["made_with"]["terrain"][0]["name"] == "ground.npz"
    )


def tables(text):
    """The tables of a page: for each the number of columns of each line."""
    out, lines = [], text.splitlines()
    for above, line in zip(["", *lines[:-1]], lines, strict=True):
        if line.startswith("|"):
            cells = len(line.replace("\\|", "").strip("|").split("|"))
            out[-1].append(cells) if above.startswith("|") else out.append([cells])
    return out


@pytest.mark.parametrize("page", ["README.md", *(f"{name}/{name}.md" for name in TINY)])
def test_pages_are_well_formed_and_hold_no_place_of_this_machine(made, terrain, page):
    text = (made[0] / page).read_text()
    assert tables(text) and all(len(set(columns)) == 1 and len(columns) > 2 for columns in tables(text))
    assert str(terrain.parent) not in text and "None" not in text and "nan" not in text
    assert "smoke run" in text
    for line in ("- networks: ", "- samples: ", "- controls: "):
        assert line in text


@pytest.mark.parametrize("name", ["table2", "fig8", "fig9", "fig11", "fig12", "fig14", "table3", "table4"])
def test_every_page_of_a_network_names_it_and_has_controls(made, name):
    text = (made[0] / name / f"{name}.md").read_text()
    assert "`tiny`" in text and "corridor" in text
    table = text.partition("## Findings")[0].splitlines()
    named = [line for line in table if line.startswith("|") and ("plain A*NN |" in line or "| `nnpp` |" in line)]
    assert all("`tiny`" in line for line in named)


def test_the_index_repeats_every_finding_under_its_verdict(made):
    text = (made[0] / "README.md").read_text()
    heads = {Verdict.AGREES: "What agrees", Verdict.BETTER: "What is better", Verdict.DIFFERS: "What does not agree"}
    for outcome in made[1]:
        for finding in outcome.findings:
            part = text.partition(heads[finding.verdict])[2].partition("\n## ")[0]
            assert finding.claim in part and finding.ours in part
        assert f"{outcome.name}/{outcome.name}.png" in text


def test_sizes_that_the_terrain_lacks_are_left_out_and_said(made):
    assert "Left out, as the terrain is no more than 256 cells a side: 512²." in (made[0] / "README.md").read_text()


def test_a_second_run_skips_what_is_complete_and_mends_what_is_not(terrain, tiny_model, tmp_path, monkeypatch):
    shrink(monkeypatch)
    request = Request(
        ["fig12", "table1"], TerrainFiles((terrain,)), tmp_path, models=(str(tiny_model),) * 2, quick=True
    )

    def ended(request):
        return [outcome.how for outcome in reproduce(request, bar=no_bar)]

    assert ended(request) == ["done", "done"]
    first = (tmp_path / "fig12" / "fig12.json").stat().st_mtime_ns
    (tmp_path / "table1" / "table1.png").unlink()
    assert ended(request) == ["skipped", "done"]
    assert (tmp_path / "fig12" / "fig12.json").stat().st_mtime_ns == first
    assert ended(replace(request, again=True)) == ["done", "done"]
    others = (str(tiny_model), "edge")
    assert ended(replace(request, models=others)) == ["done", "skipped"], "Table 1 asks no network"
    assert ended(replace(request, seed=2)) == ["done", "done"]
    assert {p.name for p in tmp_path.iterdir()} == {"fig12", "table1", "README.md"}


def test_an_experiment_that_fails_leaves_what_was_there(terrain, tiny_model, tmp_path, monkeypatch):
    shrink(monkeypatch)
    request = Request(["fig12"], TerrainFiles((terrain,)), tmp_path, models=(str(tiny_model),) * 2, quick=True)
    list(reproduce(request, bar=no_bar))
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    module = import_module("nnpp_edge.reproduction.fig12")

    def fails(context, settings, report):
        raise InvalidQueryError("no such luck")

    monkeypatch.setattr(module, "EXPERIMENT", replace(module.EXPERIMENT, run=fails))
    with pytest.raises(InvalidQueryError, match="no such luck"):
        list(reproduce(replace(request, again=True), bar=no_bar))
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_level_ground_is_no_trouble(tiny_model, tmp_path, monkeypatch):
    shrink(monkeypatch)
    np.savez(tmp_path / "flat.npz", elevation_m=np.zeros((128, 128)), cell_size_m=1.0)
    names = ["table1", "fig6", "fig7", "fig8", "table2", "fig9", "fig11", "fig12", "fig14", "table3", "table4"]
    request = Request(
        names, TerrainFiles((tmp_path / "flat.npz",)), tmp_path / "out", models=(str(tiny_model),) * 2, quick=True
    )
    assert {outcome.how for outcome in reproduce(request, bar=no_bar)} == {"done"}
    assert "nan" not in (tmp_path / "out" / "README.md").read_text()


def test_an_experiment_without_a_module_is_said_to_be_missing(terrain, tiny_model, tmp_path, monkeypatch):
    monkeypatch.setattr(experiment, "NAMES", ("table99",))
    monkeypatch.setattr(runner, "NAMES", ("table99",))
    request = Request(["table99"], TerrainFiles((terrain,)), tmp_path, models=(str(tiny_model),) * 2)
    assert [outcome.how for outcome in reproduce(request, bar=no_bar)] == ["missing"]
    assert "Not in this version of the toolkit: table99." in (tmp_path / "README.md").read_text()


def test_plain_astar_is_optimal_and_the_region_is_the_networks(tiny_model):
    cost = np.random.default_rng(3).uniform(0.0, 0.8, (70, 70)).astype(np.float32)
    case = Case("made", 70, cost, (((2, 3), (60, 66)), ((65, 4), (5, 60))))
    networks = Networks(NetworkModel(tiny_model), NetworkModel(tiny_model))
    rounds = list(contest([case], networks, 2, repeats=1))
    assert len(rounds) == 2
    for r in rounds:
        assert tuple(r.answers) == PLANNERS
        assert r.answers[PLAIN].excess == pytest.approx(0.0, abs=1e-5) and r.answers[PLAIN].mm is None
        assert r.answers[PLAIN_NN].excess >= -1e-5 and 0.0 < r.answers[PLAIN_NN].mm <= 1.0
        assert {"inference", "mask", "graph", "search"} <= set(r.answers[PLAIN_NN].stages_s)
        assert r.answers[PLAIN_NN].time_s == pytest.approx(sum(r.answers[PLAIN_NN].stages_s.values()))
    assert means(rounds, PLAIN).cc_increase == pytest.approx(0.0, abs=1e-2)
    with pytest.raises(InvalidQueryError, match="wanted 3 queries with a path, got 2"):
        list(contest([case], networks, 3, repeats=1))


def verdicts(findings):
    return [finding.verdict for finding in findings]


def test_the_papers_own_figures_agree_with_the_paper():
    times = {
        size: table1.Times(row.graph_s, row.search_s, row.path_cells, 1e-3, 1e-3)
        for size, row in paper.TABLE_1.items()
    }
    assert set(verdicts(table1.findings(times))) == {Verdict.AGREES}
    searching = {size: replace(t, graph_s=0.5 * t.search_s) for size, t in times.items()}
    assert verdicts(table1.findings(searching))[:2] == [Verdict.DIFFERS, Verdict.DIFFERS]


def scale_of(row, *, gain, cc_increase, success, control=(0.1, 0.5, 0.5)):
    """What Table 2 holds of a size: theirs, but for what the network's ways and the controls come to."""

    def one(gain, cc=0.0, found=1.0):
        traverse_cost, time_s = row.astar_cc * (1.0 + cc), row.astar_s / gain
        return Means(9, time_s, time_s, 0.0, found, traverse_cost, traverse_cost, cc, cc, None, None)

    ways = {
        PLAIN_NN: (gain, cc_increase, success),
        "nnpp": (gain, cc_increase, success),
        "corridor": control,
        **dict.fromkeys(PLAIN_CONTROLS.values(), control),
    }

    def region(cc, found):
        return RegionMeans(9, found, row.astar_cc, row.astar_cc, cc, cc, 0.05, 0.0, 0.1)

    regions = {NETWORK: region(cc_increase, success), **{kind: region(*control[1:]) for kind in CONTROLS}}
    return table2.Scale({name: one(*ways.get(name, (1.0,))) for name in PLANNERS}, regions, regions)


def scales_of(**of_all):
    """The same for both sizes of the paper; what is not given is the paper's."""
    return {
        size: scale_of(
            row,
            **({"gain": row.speedup, "cc_increase": row.cc_increase, "success": row.nn_success} | of_all),
        )
        for size, row in paper.TABLE_2.items()
    }


def test_table_2_is_judged_by_the_figures():
    found = table2.findings(scales_of())
    assert set(verdicts(found)) == {Verdict.AGREES} and not any(f.controls for f in found[:3])
    worse = table2.findings(scales_of(gain=0.5, cc_increase=0.2, success=0.5, control=(9.0, 0.0, 1.0)))
    assert set(verdicts(worse)) == {Verdict.DIFFERS} and not any(f.controls for f in worse)
    better = table2.findings(scales_of(gain=50.0, cc_increase=0.0, success=1.0))
    assert verdicts(better)[:2] == [Verdict.BETTER, Verdict.BETTER]


def test_a_verdict_that_a_control_earns_too_says_so():
    found = table2.findings(scales_of(control=(9.0, 0.0, 1.0)))
    judged = [f for f in found if "fastest" not in f.claim and "gains more" not in f.claim]
    assert all(f.controls for f in judged)
    of_plain = [f for f in judged if "plain" in f.claim]
    assert {f.controls for f in of_plain} == {("corridor", "straight band", "shuffled weights")}
    assert "says nothing about the network, a control does as well: corridor" in findings_table(found).markdown()
    fast_but_dear = table2.findings(scales_of(control=(9.0, 0.3, 1.0)))
    assert not fast_but_dear[0].controls, "a fast search for a bad path is none"


def plan_of(astar, nn, dstar, dstar_nn, control=None):
    """A plan: time and CC of each of the paper's methods, plain and compiled alike; those of the controls."""
    pairs = [(astar, (PLAIN, "astar")), (nn, (PLAIN_NN, "nnpp")), (dstar, (PLAIN_DSTAR, "dstar"))]
    pairs += [(dstar_nn, (PLAIN_DSTAR_NN, "nnpp-dstar")), (control or (99.0, 999.0), tuple(CONTROL_OF.values()))]
    answers = {name: Answer(time_s, True, cc, 0.0) for (time_s, cc), names in pairs for name in names}
    return Round(256, 100, answers)


def test_table_3_is_judged_by_the_figures(tiny_model):
    same = [plan_of(*line) for line in zip(*paper.TABLE_3.values(), strict=True)]
    found = table3.findings(same)
    assert set(verdicts(found)) == {Verdict.AGREES} and not any(f.controls for f in found)
    networks = Networks(NetworkModel(tiny_model), NetworkModel(tiny_model))
    (_, plain), (_, ours) = table3.summary(same, networks).parts
    assert plain.rows[4][1] == ours.rows[4][1] == "3.04 s"
    assert [len(row) for row in plain.rows] == [len(plain.header)] * len(plain.rows)
    worse = [plan_of((1.0, 10.0), (2.0, 12.0), (3.0, 10.0), (9.0, 12.0))]
    assert verdicts(table3.findings(worse)) == [Verdict.DIFFERS] * 9 + [Verdict.AGREES]
    better = [plan_of((9.0, 10.0), (1.0, 10.0), (3.0, 10.0), (0.1, 9.0), control=(0.1, 10.0))]
    found = table3.findings(better)
    assert verdicts(found) == [Verdict.BETTER] * 10
    assert [f.controls for f in found] == [
        (CORRIDOR,) if "NN" in f.claim or "`nnpp`" in f.claim else () for f in found[:9]
    ] + [()]


def test_table_4_is_judged_by_the_figures():
    def scenes(change=lambda row: row):
        out = []
        for s, d in zip(paper.TABLE_4_STATIC.values(), paper.TABLE_4_DYNAMIC.values(), strict=True):
            first = plan_of((s.astar_s, s.astar_cc), (s.nn_s, s.nn_cc), *[(s.astar_s, s.astar_cc)] * 2)
            rest = plan_of(
                (d.astar_s - s.astar_s, d.astar_cc - s.astar_cc),
                (d.nn_s - s.nn_s, d.nn_cc - s.nn_cc),
                (d.dstar_s - s.astar_s, d.astar_cc - s.astar_cc),
                (d.dstar_nn_s - s.astar_s, d.dstar_nn_cc - s.astar_cc),
            )
            out.append(Drive(None, (change(first), rest)))
        return table4.Scenes(out, out)

    found = table4.findings(scenes())
    assert set(verdicts(f for f in found if "mends" not in f.claim)) == {Verdict.AGREES}
    assert set(verdicts(f for f in found if "mends" in f.claim)) == {Verdict.DIFFERS}, "nobody mended"

    def slow(first):
        late = {
            name: replace(a, time_s=50.0, traverse_cost=300.0)
            for name, a in first.answers.items()
            if name in (PLAIN_NN, PLAIN_DSTAR_NN, "nnpp", "nnpp-dstar")
        }
        return replace(first, answers={**first.answers, **late})

    found = table4.findings(scenes(slow))
    agreeing = [
        f.claim
        for f in found
        if f.verdict is not Verdict.DIFFERS and "A*NN, " not in f.claim and "mends" not in f.claim
    ]
    assert agreeing == [f"speed-up of D* over A*, dynamic, both {kind}" for kind in ("plain", "ours")]


def test_an_episodes_plans_are_the_same_for_all(tiny_model):
    cost = np.random.default_rng(3).uniform(0.0, 0.8, (96, 96)).astype(np.float32)
    episode = make_episode(cost, (5, 5), (90, 88), seed=2, stride=stride_on(96))
    assert (stride_on(96), stride_on(256), stride_on(1024)) == (16, 45, 45)
    driven = drive(episode, Networks(NetworkModel(tiny_model), NetworkModel(tiny_model)), 1)
    assert len(driven.rounds) == len(episode.steps) > 2
    for answered in driven.rounds:
        exact = answered.answers["astar"]
        assert answered.answers[PLAIN].traverse_cost == pytest.approx(exact.traverse_cost, rel=1e-2)
        assert all(a.excess >= -1e-5 and a.time_s > 0.0 for a in answered.answers.values())
        for exact_too in ("dstar", PLAIN_DSTAR):
            assert answered.answers[exact_too].excess == pytest.approx(0.0, abs=1e-5)
        in_region = [answered.answers[name] for name in (PLAIN_NN, PLAIN_DSTAR_NN)]
        assert in_region[0].excess == pytest.approx(in_region[1].excess, abs=1e-5), "the same region, mended or not"
    assert [each.answers[PLAIN_DSTAR_NN].mended for each in driven.rounds[:2]] == [False, True]
    assert mended(driven.rounds[1:], PLAIN_DSTAR) == f"{len(driven.rounds) - 1} of {len(driven.rounds) - 1}"
    views = view_episode(episode, NetworkModel(tiny_model))
    way = driven_way(views, stride_on(96))
    assert tuple(way[0]) == (5, 5) and tuple(way[-1]) == (90, 88)
    assert np.abs(np.diff(way, axis=0)).max() == 1


def test_the_animation_shows_what_changes(tiny_model):
    cost = np.random.default_rng(3).uniform(0.0, 0.8, (64, 64)).astype(np.float32)
    episode = make_episode(cost, (5, 5), (60, 58), seed=2, stride=stride_on(64))
    views = view_episode(episode, NetworkModel(tiny_model))
    with Image.open(io.BytesIO(animate(views, stride_on(64), 10))) as gif:
        frames = [np.asarray(frame.convert("RGB"), int) for frame in ImageSequence.Iterator(gif)]
        assert gif.info["loop"] == 0
    assert len(frames) >= 3 * len(views) - 1
    moved = [np.abs(b - a).max(axis=2) > 40 for a, b in zip(frames, frames[1:], strict=False)]
    assert all(m.any() for m in moved[:-1])
    red = (frames[0] == (255, 0, 0)).all(axis=2)
    assert red.any()  # the goal keeps its colour


def test_an_animation_that_is_missing_is_noticed(made, tmp_path):
    folder = tmp_path / "table3"
    shutil.copytree(made[0] / "table3", folder)
    assert runner.read_experiment(folder)["animated"]
    assert "table3.gif" in (folder / "table3.md").read_text()
    (folder / "table3.gif").unlink()
    assert runner.read_experiment(folder) is None


def test_the_best_omega_is_where_length_and_cc_together_are_least():
    omegas = np.array([0.0, 0.01, 0.02, 0.03])
    length = np.array([[10.0, 11.0, 20.0, 30.0], [10.0, 10.0, 10.0, 12.0]])
    cc = np.array([[9.0, 3.0, 2.0, 1.0], [8.0, 8.0, 2.0, 2.0]])
    sweep = fig7.Sweep(omegas, length, cc, np.ones((2, 4)))
    assert sweep.best().tolist() == [0.01, 0.02]
    # divided by the greatest: [10/30 + 1, 11/30 + 3/9, ...] on the first map
    assert sweep.best_by_greatest().tolist() == [0.01, 0.02]
    flat = fig7.Sweep(omegas, np.ones((1, 4)), np.ones((1, 4)), np.ones((1, 4)))
    assert flat.best().tolist() == [0.02]


def test_the_normalisation_decides_the_best_omega():
    omegas = np.array([0.0, 0.01, 0.02])
    sweep = fig7.Sweep(omegas, np.array([[100.0, 106.0, 110.0]]), np.array([[50.0, 30.0, 20.0]]), np.ones((1, 3)))
    assert sweep.best().tolist() == [0.01]
    assert sweep.best_by_greatest().tolist() == [0.02]


def test_each_encoding_is_trained_for_the_steps_asked_for(made):
    with (made[0] / "fig13" / "fig13.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["encoding"] for row in rows] == ["G: 1/4", "G: 1/16", "pixel"]
    assert {row["steps"] for row in rows} == {"1"}
    assert all(0.0 < float(row["mm"]) <= 1.0 and float(row["success"]) == 1.0 for row in rows)


def test_training_and_validation_see_different_ground(terrain):
    dem = read_dem(terrain)
    mine, held_out = fig13.side_of(dem, False).elevation, fig13.side_of(dem, True).elevation
    assert mine.shape[1] + held_out.shape[1] == 256 and held_out.shape[1] == 128
    assert np.array_equal(np.hstack([mine, held_out]), dem.elevation)


def test_a_data_sets_maps_are_split_between_training_and_validation(tmp_path):
    make_dataset(Recipe((), maps=8, size=128, blocks=32, maps_per_shard=8), tmp_path, workers=1)
    samples = read_samples(tmp_path)
    context = experiment.Context([], 1, None, tmp_path, dataset=tmp_path)
    mine, held_out = fig13.make_samples(context, fig13.EXPERIMENT.full)
    assert set(mine.map_index) | set(held_out.map_index) == set(range(8))
    assert set(mine.map_index) == set(range(6)) and len(mine) + len(held_out) == len(samples)


def test_a_table_is_markdown_and_csv():
    table = Table(("a", "b"), [("x|y", 1.5), (None, float("nan"))])
    assert table.markdown() == "| a | b |\n| --- | --- |\n| x\\|y | 1.5 |\n| – | nan |\n"
    assert table.csv() == "a,b\nx|y,1.5\n,\n"


def test_the_command_prints_a_line_for_each_experiment_and_json_for_programs(
    nnpp_edge, terrain, tiny_model, tmp_path, monkeypatch
):
    shrink(monkeypatch)
    words = ["reproduce", "table1", "fig12", "--quick", "--terrain", terrain, "--model", tiny_model, "-o", tmp_path]
    ended = nnpp_edge(*words)
    assert ended.code == 0, ended.err
    first, second, last = ended.out.splitlines()
    assert first.startswith("table1: ") and second.startswith("fig12: ") and last.endswith("README.md")
    ended = nnpp_edge(*words, "--json")
    told = json.loads(ended.out)
    assert [(e["experiment"], e["ended"]) for e in told["experiments"]] == [
        ("table1", "skipped"),
        ("fig12", "skipped"),
    ]
    assert all(f["verdict"] in list(Verdict) for e in told["experiments"] for f in e["findings"])


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["fig99"], "wanted EXPERIMENT of table1"),
        (["fig13", "--steps", "0"], "--steps"),
        (["--seed", "many"], "--seed"),
        (["--model", "edge", "--model", "edge", "--model", "edge"], "at most two of --model"),
    ],
)
def test_wrong_use_is_refused(nnpp_edge, tmp_path, words, wanted):
    ended = nnpp_edge("reproduce", *words, "-o", tmp_path / "out")
    assert ended.code == 2 and wanted in ended.err
    assert not (tmp_path / "out").exists()


def test_bad_input_ends_in_one_line(nnpp_edge, terrain, tmp_path, bad_dem):
    out = tmp_path / "result"
    path, word = bad_dem
    nnpp_edge("reproduce", "fig12", "--quick", "--terrain", path, "-o", out).refused(word)
    nnpp_edge("reproduce", "--terrain", terrain, "--model", tmp_path / "no.onnx", "-o", out).refused("no.onnx")
    nnpp_edge("reproduce", "--terrain", terrain, "--dataset", tmp_path / "none", "-o", out).refused("dataset.json")


def test_terrain_that_is_too_small_is_refused(nnpp_edge, tiny_model, tmp_path):
    np.savez(tmp_path / "small.npz", elevation_m=np.zeros((40, 50)), cell_size_m=1.0)
    words = ["--quick", "--terrain", tmp_path / "small.npz", "--model", tiny_model, "-o", tmp_path / "out"]
    nnpp_edge("reproduce", "table1", *words).refused("wanted terrain of at least 64 cells a side, got 40")
    nnpp_edge("reproduce", "fig13", *words).refused("wanted terrain of at least 128 × 256 cells, got 40 × 50")


def test_a_file_in_the_way_of_the_output_is_refused(nnpp_edge, terrain, tiny_model, tmp_path):
    (tmp_path / "file").write_text("in the way")
    ended = nnpp_edge("reproduce", "--terrain", terrain, "--model", tiny_model, "-o", tmp_path / "file" / "out")
    ended.refused("wanted a folder to write to")
