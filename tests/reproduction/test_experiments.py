"""Experiments from the command to the page, and verdicts from figures."""

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
    OURS,
    PLAIN,
    PLAIN_CONTROLS,
    PLAIN_NN,
    PLANNERS,
    OneMap,
)
from nnpp_edge.reproduction.regions import CORRIDOR
from nnpp_edge.reproduction.rows import Rows
from nnpp_edge.reproduction.runner import EXPERIMENTS, finding_cells, reproduce
from nnpp_edge.reproduction.table import summary
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
"""Settings in place of each experiment's quick ones."""
WITHOUT_NETWORK = ("table1", "fig7")


@pytest.fixture(autouse=True, scope="module")
def shrink():
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(runner, "exercise", lambda: None)  # no test reads the times
        for name, quick in TINY.items():
            monkeypatch.setitem(EXPERIMENTS, name, replace(EXPERIMENTS[name], quick=quick))
        yield


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("terrain") / "ground.npz"
    heights = synthetic_terrain(np.random.default_rng(4), 256, 5.0)
    np.savez(path, elevation_m=heights, cell_size_m=5.0)
    return path


@pytest.fixture(scope="module")
def run(terrain, tiny_model):
    """Run experiments into a folder; what is stored of each by name, and whether it was run."""

    def run_into(folder, *names, models=(tiny_model, tiny_model), **more):
        files = TerrainFiles((terrain,))
        paths = tuple(map(str, models))
        ended = reproduce(names or list(TINY), files, folder, models=paths, quick=True, **more)
        return {stored.name: (stored, ran) for stored, ran in ended}

    return run_into


@pytest.fixture(scope="module")
def made(run, tmp_path_factory):
    """The folder of a run of everything, and what is stored of each experiment by name."""
    folder = tmp_path_factory.mktemp("made") / "out"
    ended = run(folder)
    assert all(ran for _, ran in ended.values())
    return folder, {name: stored for name, (stored, _) in ended.items()}


@pytest.mark.parametrize("name", TINY)
def test_an_experiment_writes_its_figures_and_picture(made, name):
    folder = made[0] / name
    assert {path.suffix for path in folder.iterdir()} == {".csv", ".png", ".json"}
    with (folder / f"{name}.csv").open() as file:
        header, *rows = csv.reader(file)
    assert rows
    assert len(set(header)) == len(header)
    assert {len(row) for row in rows} == {len(header)}
    assert any(cell.replace(".", "").isdigit() for row in rows for cell in row)
    with Image.open(folder / f"{name}.png") as picture:
        assert min(picture.size) > 300
        assert len(set(picture.convert("L").resize((64, 64)).tobytes())) > 8
    facts = json.loads((folder / f"{name}.json").read_text())
    assert facts["quick"]
    assert facts["made_with"]["terrain"].startswith("`ground.npz` (cells of 5 m, ")


@pytest.mark.parametrize("name", TINY)
def test_findings_stand_on_the_page_under_their_verdicts(made, name):
    folder, stored = made
    page = (folder / "README.md").read_text()
    heads = {
        Verdict.AGREES: "## What agrees",
        Verdict.BETTER: "## What is better",
        Verdict.DIFFERS: "## What does not agree",
    }
    assert stored[name].findings
    for finding in stored[name].findings:
        part = page.partition(heads[finding.verdict])[2].partition("\n## ")[0]
        assert finding.claim in part
        assert finding.ours in part


@pytest.mark.parametrize("name", TINY)
def test_a_section_of_the_page_has_a_picture_and_names_the_network_and_its_controls(made, name):
    page = (made[0] / "README.md").read_text()
    section = page.partition(f'<a id="{name}">')[2].partition("<a id")[0]
    for words in (f"]({name}/{name}.png)", "- networks: ", "- samples: ", "- controls: "):
        assert words in section
    if name in WITHOUT_NETWORK:
        return
    assert "corridor" in section
    of_network = [
        line for line in section.splitlines() if "| plain A*NN |" in line or "| `nnpp` |" in line
    ]
    assert "`tiny`" in section
    assert all("`tiny`" in line for line in of_network)


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


def test_a_second_run_skips_what_is_complete_and_mends_what_is_not(run, tiny_model, tmp_path):
    def ended(**more):
        return [ran for _, ran in run(tmp_path, "fig12", "table1", **more).values()]

    assert ended() == [True, True]
    first = (tmp_path / "fig12" / "fig12.json").stat().st_mtime_ns
    (tmp_path / "table1" / "table1.png").unlink()
    assert ended() == [False, True]
    assert (tmp_path / "fig12" / "fig12.json").stat().st_mtime_ns == first
    assert ended(again=True) == [True, True]
    assert ended(models=(tiny_model, "edge")) == [True, False], "Table 1 uses no network"
    assert ended(seed=2) == [True, True]
    assert {path.name for path in tmp_path.iterdir()} == {"fig12", "table1", "README.md"}


def test_an_experiment_that_fails_leaves_what_was_there(run, tmp_path, monkeypatch):
    def contents():
        return {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def fails(context, **settings):
        raise InvalidQueryError("no such luck")

    run(tmp_path, "table1")
    before = contents()
    monkeypatch.setitem(EXPERIMENTS, "table1", replace(EXPERIMENTS["table1"], run=fails))
    with pytest.raises(InvalidQueryError, match="no such luck"):
        run(tmp_path, "table1", again=True)
    assert contents() == before


def test_the_command_prints_a_line_for_each_experiment_and_json_for_programs(
    nnpp_edge, terrain, tiny_model, tmp_path
):
    words = ["reproduce", "table1", "fig12", "--quick", "--terrain", terrain]
    words += ["--model", tiny_model, "-o", tmp_path]
    ended = nnpp_edge(*words)
    assert ended.code == 0, ended.err
    first, second, last = ended.out.splitlines()
    assert first.startswith("table1: ")
    assert second.startswith("fig12: ")
    assert last.endswith("README.md")
    found = json.loads(nnpp_edge(*words, "--json").out)["experiments"]
    assert [each["experiment"] for each in found] == ["table1", "fig12"]
    assert {each["ended"] for each in found} == {"skipped"}
    for each in found:
        assert {finding["verdict"] for finding in each["findings"]} <= set(Verdict)


@pytest.mark.parametrize("timed", [True, False])
def test_plain_astar_is_optimal_and_the_region_is_the_networks(tiny_networks, timed):
    cost = np.random.default_rng(3).uniform(0.0, 0.8, (70, 70)).astype(np.float32)
    here = OneMap(cost, ((2, 3), (60, 66)), tiny_networks)
    rows = here.timed(PLANNERS, 1, Harness()) if timed else here.untimed()
    assert [row["planner"] for row in rows] == [
        name for name in PLANNERS if timed or name not in OURS
    ]
    (exact_row,) = rows.of(PLAIN)
    assert exact_row["excess"] == pytest.approx(0.0, abs=1e-5)
    assert "mm" not in exact_row
    (nn,) = rows.of(PLAIN_NN)
    assert nn["excess"] >= -1e-5
    assert 0.0 < nn["mm"] <= 1.0
    assert rows.increase(PLAIN) == pytest.approx(0.0, abs=1e-2)
    if timed:
        assert 0.0 < nn["inference_s"] < nn["time_s"]


def test_an_episode_is_driven_by_all(tiny_networks):
    cost = np.random.default_rng(3).uniform(0.0, 0.8, (96, 96)).astype(np.float32)
    episode = make_episode(cost, (5, 5), (90, 88), seed=2, stride=dynamic.stride_on(96))
    plans = len(episode.steps)
    rows = dynamic.drive(episode, tiny_networks, 1)
    assert plans > 2
    assert len(rows) == plans * len(dynamic.PLANNERS)
    for plan in rows.by("plan").values():
        assert plan.of(PLAIN).mean("excess") == pytest.approx(0.0, abs=1e-5)
        for name in ("astar", "dstar"):
            assert plan.increase(name) == pytest.approx(0.0, abs=1e-2)
    assert rows.of("dstar").all("mended") == [0.0] + [1.0] * (plans - 1)


def verdicts(findings):
    return [finding.verdict for finding in findings]


@pytest.mark.parametrize(
    ("graph_share", "wanted"), [(None, [Verdict.AGREES] * 3), (1 / 3, [Verdict.DIFFERS] * 2)]
)
def test_table_1_is_judged_by_the_figures(graph_share, wanted):
    """The paper's own figures agree with the paper."""
    rows = Rows({**row, "planner": PLAIN} for row in paper.TABLE_1)
    if graph_share is not None:
        rows = Rows({**row, "graph_share": graph_share} for row in rows)
    assert verdicts(exact.table1_findings(rows))[: len(wanted)] == wanted


def table2_findings(network=None, control=(0.1, 0.5, 0.5)):
    """Findings on rows like the paper's, plain and compiled alike, with speed-up, CC increase and
    success of the network's planners and of the controls.
    """
    rows = Rows()
    for size, theirs in paper.TABLE_2.by("size").items():
        (row,) = theirs.of(paper.ASTAR)
        gain = theirs.speedup(paper.ASTAR, paper.ASTAR_NN)
        success = theirs.of(paper.ASTAR_NN).mean("found")
        own = network or (gain, theirs.increase(paper.ASTAR_NN), success)
        answers = dict.fromkeys((PLAIN, "astar"), (1.0, 0.0, 1.0))
        answers |= dict.fromkeys((PLAIN_NN, "nnpp"), own)
        answers |= dict.fromkeys(("corridor", *PLAIN_CONTROLS.values()), control)
        for name, (faster, increase, found) in answers.items():
            time_s = row["time_s"] / faster
            cc = row["cc"] * (1.0 + increase)
            figures = {"planner": name, "time_s": time_s, "cc": cc, "found": found}
            rows.append(row | figures)
    return list(static.table2_findings(rows))


CONTROL_WINS = (9.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("figures", "wanted"),
    [
        ([], Verdict.AGREES),
        ([(0.5, 0.2, 0.5), CONTROL_WINS], Verdict.DIFFERS),
        ([(50.0, 0.0, 1.0)], Verdict.BETTER),
    ],
)
def test_table_2_is_judged_by_the_figures(figures, wanted):
    found = table2_findings(*figures)
    assert verdicts(found)[:5] == [wanted] * 5
    assert not any(finding.controls for finding in found[:5])
    if wanted is not Verdict.BETTER:
        assert set(verdicts(found)) == {wanted}


def test_a_verdict_that_a_control_earns_too_says_so():
    found = table2_findings(control=CONTROL_WINS)
    judged = [each for each in found if "fastest" not in each.claim and "gains" not in each.claim]
    for finding in judged:
        all_three = ("corridor", "straight band", "shuffled weights")
        assert finding.controls == (all_three if "A*NN" in finding.claim else ("corridor",))
    words = "says nothing about the network, a control does as well: corridor"
    assert words in finding_cells(found[0])[-1]
    fast_but_dear = table2_findings(control=(9.0, 0.3, 1.0))
    assert not fast_but_dear[0].controls


METHODS = (paper.ASTAR, paper.ASTAR_NN, paper.DSTAR, paper.DSTAR_NN)


def answered(plan, answers, control=(99.0, 999.0)):
    """Rows of a plan: time and CC by the paper's methods, plain and compiled alike, and those of
    the corridors.
    """
    found = {kinds[CORRIDOR]: control for kinds in CONTROLS_OF.values()}
    for method, answer in zip(METHODS, answers, strict=True):
        found[dynamic.OURS_OF[method]] = answer
        if method in dynamic.PLAIN_OF:
            found[dynamic.PLAIN_OF[method]] = answer
    exact_cc = answers[0][1]
    return [
        {"plan": plan, "planner": name, "time_s": time_s, "cc": cc, "exact_cc": exact_cc}
        for name, (time_s, cc) in found.items()
    ]


def test_table_3_is_judged_by_the_figures():
    same = Rows()
    for plan, of in paper.TABLE_3.by("plan").items():
        same += answered(plan, [(row["time_s"], row["cc"]) for row in of])
    found = list(dynamic.table3_findings(same))
    assert set(verdicts(found)) == {Verdict.AGREES}
    assert not any(finding.controls for finding in found)
    worse = Rows(answered(0, [(1.0, 10.0), (2.0, 12.0), (3.0, 10.0), (9.0, 12.0)]))
    found = verdicts(dynamic.table3_findings(worse))
    assert found == [Verdict.DIFFERS] * 6 + [Verdict.AGREES]
    answers = [(9.0, 10.0), (1.0, 10.0), (3.0, 10.0), (0.1, 9.0)]
    better = list(dynamic.table3_findings(Rows(answered(0, answers, control=(0.1, 10.0)))))
    assert verdicts(better) == [Verdict.BETTER] * 7
    for finding in better[:6]:
        assert finding.controls == ((CORRIDOR,) if "NN" in finding.claim else ())


@pytest.mark.parametrize(
    ("length", "cc", "wanted"),
    [
        # divided by the greatest: [10/30 + 1, 11/30 + 3/9, 1 + 2/9] on the first map
        ([[10, 11, 30], [10, 10, 12]], [[9, 3, 2], [8, 2, 2]], [[0.01, 0.01], [0.01, 0.01]]),
        ([[1, 1, 1]], [[1, 1, 1]], [[0.01], [0.01]]),
        ([[100, 106, 110]], [[50, 30, 20]], [[0.01], [0.02]]),
    ],
    ids=["two maps", "all the same", "the normalisation decides"],
)
def test_the_best_omega_is_where_length_and_cc_together_are_least(length, cc, wanted):
    omegas = np.array([0.0, 0.01, 0.02])
    found = []
    for normal in (exact.by_range, exact.by_greatest):
        total = normal(np.array(length)) + normal(np.array(cc))
        found.append(exact.best_omegas(omegas, total))
    assert found == wanted


def test_sums_are_over_the_queries_that_all_answered(tiny_networks):
    answer = {"scene": "-d", "planner": PLAIN, "cc": 10.0, "exact_cc": 10.0, "found": 1.0}
    failed = {"scene": "-d", "planner": PLAIN_NN, "plan": 1, "time_s": 1.0, "found": 0.0}
    rows = Rows(
        [
            {**answer, "plan": 0, "time_s": 4.0},
            {**answer, "plan": 1, "time_s": 90.0},
            {**answer, "plan": 0, "planner": PLAIN_NN, "time_s": 2.0, "cc": 12.0},
            failed,
        ]
    )
    assert rows.speedup(PLAIN, PLAIN_NN) == 2.0
    table = summary(rows, ("scene", "planner"), tiny_networks, totals=True)
    head, _, exact_line, nn_line = table.splitlines()
    assert head.endswith("| time in all | over A* | CC | CC increase | failed |")
    assert exact_line.endswith("| 4 s | 1× | 10.00 | 0.00 % | 0 of 2 |")
    assert nn_line.endswith("| 2 s | 2× | 12.00 | 20.00 % | 1 of 2 |")


def test_rows_become_csv_and_figures():
    rows = Rows(
        [
            {"planner": "a", "time_s": 1.5, "cc": 3.0, "exact_cc": 2.0},
            {"planner": "b", "time_s": float("nan")},
        ]
    )
    assert rows.csv() == "planner,time_s,cc,exact_cc\na,1.5,3.0,2.0\nb,,,\n"
    assert rows.increase("a") == 0.5
    assert np.isnan(rows.increase("b"))
    assert np.isnan(rows.mean("mm"))
