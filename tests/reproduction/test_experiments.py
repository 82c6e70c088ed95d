import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.suites import TerrainFiles
from nnpp_edge.reproduction import dynamic, exact, paper, runner, static
from nnpp_edge.reproduction.episode import make_episode
from nnpp_edge.reproduction.findings import Verdict
from nnpp_edge.reproduction.planners import (
    CONTROLS_OF,
    PLAIN,
    PLAIN_CONTROLS,
    PLAIN_NN,
    PLANNERS,
    answers,
    summary,
)
from nnpp_edge.reproduction.regions import CORRIDOR, Networks
from nnpp_edge.reproduction.rows import Rows
from nnpp_edge.reproduction.runner import EXPERIMENTS, finding_cells, reproduce
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


def verdicts(findings):
    return [finding.verdict for finding in findings]


def test_the_papers_own_figures_agree_with_the_paper():
    times = Rows({**row, "planner": PLAIN} for row in paper.TABLE_1)
    assert set(verdicts(exact.table1_findings(times))) == {Verdict.AGREES}
    searching = Rows({**row, "graph_share": 1 / 3} for row in times)
    assert verdicts(exact.table1_findings(searching))[:2] == [Verdict.DIFFERS, Verdict.DIFFERS]


def as_in_table2(*, control=(0.1, 0.5, 0.5), **of_all):
    """Rows like the paper's, plain and compiled alike, but for what the network's ways and the
    controls come to.
    """
    rows = Rows()
    for (size,), theirs in paper.TABLE_2.by("size").items():
        (row,), (nn,) = theirs.of(paper.ASTAR), theirs.of(paper.ASTAR_NN)
        gain = of_all.get("gain", row["time_s"] / nn["time_s"])
        cc_increase = of_all.get("cc_increase", nn["cc"] / nn["exact_cc"] - 1.0)
        found = of_all.get("found", nn["found"])
        ways = {PLAIN: (1.0, 0.0, 1.0), "astar": (1.0, 0.0, 1.0), "corridor": control}
        ways |= dict.fromkeys(PLAIN_CONTROLS.values(), control) | dict.fromkeys(
            (PLAIN_NN, "nnpp"), (gain, cc_increase, found)
        )
        for name, (faster, more, share) in ways.items():
            cc = row["cc"] * (1.0 + more)
            place = {"size": size, "planner": name, "time_s": row["time_s"] / faster}
            rows.append(place | {"cc": cc, "exact_cc": row["cc"], "found": share})
    return rows


def test_table_2_is_judged_by_the_figures():
    found = static.table2_findings(as_in_table2())
    assert set(verdicts(found)) == {Verdict.AGREES} and not any(f.controls for f in found[:5])
    worse = static.table2_findings(
        as_in_table2(gain=0.5, cc_increase=0.2, found=0.5, control=(9.0, 0.0, 1.0))
    )
    assert set(verdicts(worse)) == {Verdict.DIFFERS} and not any(f.controls for f in worse)
    better = static.table2_findings(as_in_table2(gain=50.0, cc_increase=0.0, found=1.0))
    assert verdicts(better)[:5] == [Verdict.BETTER] * 5


def test_a_verdict_that_a_control_earns_too_says_so():
    found = static.table2_findings(as_in_table2(control=(9.0, 0.0, 1.0)))
    judged = [f for f in found if "fastest" not in f.claim and "gains more" not in f.claim]
    assert all(f.controls for f in judged)
    assert {f.controls for f in judged if "plain" in f.claim} == {
        ("corridor", "straight band", "shuffled weights")
    }
    assert (
        "says nothing about the network, a control does as well: corridor"
        in finding_cells(found[0])[-1]
    )
    fast_but_dear = static.table2_findings(as_in_table2(control=(9.0, 0.3, 1.0)))
    assert not fast_but_dear[0].controls, "a fast search for a bad path is none"


def answered(place, methods, control=(99.0, 999.0), mended=0.0):
    """Rows of a plan: time and CC by the paper's methods, plain and compiled alike; those of the
    controls.
    """
    ways = {
        of[theirs]: way
        for of in (dynamic.PLAIN_OF, dynamic.OURS_OF)
        for theirs, way in methods.items()
        if theirs in of
    }
    ways |= {
        name: control
        for kinds in CONTROLS_OF.values()
        for kind, name in kinds.items()
        if kind == CORRIDOR
    }
    astar_cc = methods[paper.ASTAR][1]
    return [
        {
            **place,
            "planner": name,
            "time_s": time_s,
            "cc": cc,
            "exact_cc": astar_cc,
            "mended": mended,
        }
        for name, (time_s, cc) in ways.items()
    ]


METHODS = (paper.ASTAR, paper.ASTAR_NN, paper.DSTAR, paper.DSTAR_NN)


def test_table_3_is_judged_by_the_figures():
    same = Rows()
    for (at,), of in paper.TABLE_3.by("plan").items():
        same += answered({"plan": at}, {row["planner"]: (row["time_s"], row["cc"]) for row in of})
    found = dynamic.table3_findings(same)
    assert set(verdicts(found)) == {Verdict.AGREES} and not any(f.controls for f in found)

    def of(*ways, **more):
        return dynamic.table3_findings(
            Rows(answered({"plan": 0}, dict(zip(METHODS, ways, strict=True)), **more))
        )

    worse = of((1.0, 10.0), (2.0, 12.0), (3.0, 10.0), (9.0, 12.0))
    assert verdicts(worse) == [Verdict.DIFFERS] * 6 + [Verdict.AGREES]
    better = of((9.0, 10.0), (1.0, 10.0), (3.0, 10.0), (0.1, 9.0), control=(0.1, 10.0))
    assert verdicts(better) == [Verdict.BETTER] * 7
    assert [f.controls for f in better] == [
        (CORRIDOR,) if "NN" in f.claim else () for f in better[:6]
    ] + [()]


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


def test_the_best_omega_is_where_length_and_cc_together_are_least():
    def best(omegas, length, cc):
        length = np.array(length)
        cc = np.array(cc)
        made = (
            (exact.by_range(length), exact.by_range(cc)),
            (exact.by_greatest(length), exact.by_greatest(cc)),
        )
        return [exact.best_omegas(np.array(omegas), *each).tolist() for each in made]

    omegas = [0.0, 0.01, 0.02, 0.03]
    length = [[10.0, 11.0, 20.0, 30.0], [10.0, 10.0, 10.0, 12.0]]
    # divided by the greatest: [10/30 + 1, 11/30 + 3/9, ...] on the first map
    assert best(omegas, length, [[9.0, 3.0, 2.0, 1.0], [8.0, 8.0, 2.0, 2.0]]) == [[0.01, 0.02]] * 2
    assert best(omegas, np.ones((1, 4)), np.ones((1, 4)))[0] == [0.02]
    assert best(omegas[:3], [[100.0, 106.0, 110.0]], [[50.0, 30.0, 20.0]]) == [[0.01], [0.02]], (
        "it decides"
    )


def test_sums_are_over_the_queries_that_all_answered(tiny_model):
    on_both = [
        {"planner": PLAIN, "time_s": time_s, "cc": 10.0, "exact_cc": 10.0, "found": 1.0}
        for time_s in (4.0, 90.0)
    ]
    found = {"planner": PLAIN_NN, "time_s": 2.0, "cc": 12.0, "exact_cc": 10.0, "found": 1.0}
    failed = {"planner": PLAIN_NN, "time_s": 1.0, "found": 0.0}
    rows = Rows(
        {"scene": "-d", "plan": at % 2, **row} for at, row in enumerate((*on_both, found, failed))
    )
    assert rows.speedup(PLAIN, PLAIN_NN) == 2.0
    networks = Networks(NetworkModel(tiny_model), NetworkModel(tiny_model))
    head, _, exact_line, nn_line = summary(
        rows, ("scene", "planner"), networks, totals=True
    ).splitlines()
    assert [name.strip() for name in head.split("|")[4:-1]] == [
        "time in all",
        "over A*",
        "CC",
        "CC increase",
        "failed",
    ]
    assert "| 4 s | 1× | 10.00 |" in exact_line and "| 0 of 2 |" in exact_line
    assert "| 2 s | 2× | 12.00 | 20.00 % | 1 of 2 |" in nn_line


def test_rows_become_csv_and_figures():
    rows = Rows(
        [
            {"planner": "a", "time_s": 1.5, "cc": 3.0, "exact_cc": 2.0},
            {"planner": "b", "time_s": float("nan")},
        ]
    )
    assert rows.csv() == "planner,time_s,cc,exact_cc\na,1.5,3.0,2.0\nb,,,\n"
    assert rows.increase("a") == 0.5 and np.isnan(rows.increase("b")) and np.isnan(rows.mean("mm"))


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
