"""The paper's claims, judged by figures: verdicts, controls, sums and their table."""

import numpy as np

from nnpp_edge.reproduction import dynamic, exact, paper, static
from nnpp_edge.reproduction.findings import Verdict
from nnpp_edge.reproduction.planners import (
    CONTROLS_OF,
    PLAIN,
    PLAIN_CONTROLS,
    PLAIN_NN,
    summary,
)
from nnpp_edge.reproduction.regions import CORRIDOR, Networks
from nnpp_edge.reproduction.rows import Rows
from nnpp_edge.reproduction.runner import finding_cells
from nnpp_edge.runtime import NetworkModel


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
