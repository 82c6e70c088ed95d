"""The paper's claims, judged by figures: verdicts, controls, sums and their table."""

import numpy as np
import pytest

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction import dynamic, exact, paper, static
from nnpp_edge.reproduction.findings import OURS_OF, Verdict
from nnpp_edge.reproduction.planners import CONTROLS_OF, PLAIN, PLAIN_CONTROLS, PLAIN_NN
from nnpp_edge.reproduction.regions import CORRIDOR
from nnpp_edge.reproduction.table import summary


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
        assert finding.controls == (("corridor",) if "both ours" in finding.claim else all_three)
    assert found[0].cells[-1].startswith("corridor")
    fast_but_dear = table2_findings(control=(9.0, 0.3, 1.0))
    assert not fast_but_dear[0].controls


METHODS = (paper.ASTAR, paper.ASTAR_NN, paper.DSTAR, paper.DSTAR_NN)


def answered(plan, answers, control=(99.0, 999.0)):
    """Rows of a plan: time and CC by the paper's methods, plain and compiled alike, and those of
    the corridors.
    """
    found = {kinds[CORRIDOR]: control for kinds in CONTROLS_OF.values()}
    for method, answer in zip(METHODS, answers, strict=True):
        for ours in OURS_OF.values():
            if method in ours:
                found[ours[method]] = answer
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
    better = list(dynamic.table3_findings(Rows(answered(0, answers, control=(0.1, 9.0)))))
    assert verdicts(better) == [Verdict.BETTER] * 7
    for finding in better[:6]:
        assert finding.controls == ((CORRIDOR,) if "NN" in finding.claim else ())


@pytest.mark.parametrize(
    ("length", "cc", "wanted"),
    [
        # divided by the greatest: 10/30 + 1, 11/30 + 3/9, ...
        ([10.0, 11.0, 20.0, 30.0], [9.0, 3.0, 2.0, 1.0], [0.01, 0.01]),
        ([10.0, 10.0, 10.0, 12.0], [8.0, 8.0, 2.0, 2.0], [0.02, 0.02]),
        ([1.0] * 4, [1.0] * 4, [0.02, 0.02]),
        ([100.0, 106.0, 110.0], [50.0, 30.0, 20.0], [0.01, 0.02]),
    ],
)
def test_the_best_omega_is_where_length_and_cc_together_are_least(length, cc, wanted):
    """By range, and by the greatest."""
    omegas = 0.01 * np.arange(len(length))
    totals = [
        normal(np.array(length)) + normal(np.array(cc))
        for normal in (exact.by_range, exact.by_greatest)
    ]
    assert [exact.best_omega(omegas, total) for total in totals] == wanted


def test_sums_are_over_the_queries_that_all_answered():
    def answer(planner, plan, time_s, **more):
        return {"scene": "-d", "planner": planner, "plan": plan, "time_s": time_s, **more}

    exact = {"cc": 10.0, "exact_cc": 10.0, "found": 1.0}
    rows = Rows(answer(PLAIN, plan, time_s, **exact) for plan, time_s in ((0, 4.0), (1, 90.0)))
    rows.append(answer(PLAIN_NN, 0, 2.0, **exact | {"cc": 12.0}))
    rows.append(answer(PLAIN_NN, 1, 1.0, found=0.0))
    assert rows.speedup(PLAIN, PLAIN_NN) == 2.0
    table = summary(rows, ("scene", "planner"), totals=True)
    head, _, exact_line, nn_line = table.splitlines()
    assert head.endswith("| time in all | over A* | CC | CC increase | failed |")
    assert exact_line.endswith("| 4 s | 1× | 10.00 | 0.00 % | 0 of 2 |")
    assert nn_line.endswith("| 2 s | 2× | 12.00 | 20.00 % | 1 of 2 |")


def test_rows_become_csv_and_figures():
    whole = {"planner": "a", "time_s": 1.5, "cc": 3.0, "exact_cc": 2.0}
    rows = Rows([whole, {"planner": "b", "time_s": np.nan}])
    assert rows.csv() == "planner,time_s,cc,exact_cc\na,1.5,3.0,2.0\nb,,,\n"
    assert rows.increase("a") == 0.5
    assert np.isnan([rows.increase("b"), rows.mean("mm")]).all()
