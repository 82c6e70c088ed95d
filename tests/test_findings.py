"""The paper's claims, judged by figures: verdicts, controls, sums and their table."""

import numpy as np
import pytest

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction import dynamic, exact, paper, static
from nnpp_edge.reproduction.findings import OURS_OF, Verdict
from nnpp_edge.reproduction.planners import CONTROLS_OF, PLAIN, PLAIN_NN
from nnpp_edge.reproduction.regions import CONTROLS, CORRIDOR
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


def ours_like(theirs, network, control):
    """The paper's rows as ours, plain and compiled alike; those of the networks' planners, and of
    the controls in their place, with so many times their speed, CC increase and success.
    """
    rows = Rows()
    for names in OURS_OF.values():
        for row in theirs.having("cc"):
            name = names.get(row["planner"])
            answers = {name: network, **dict.fromkeys(CONTROLS_OF.get(name, {}).values(), control)}
            for planner, (faster, increase, found) in answers.items():
                own = {**row, "planner": planner}
                if name in CONTROLS_OF:
                    own |= {"time_s": row["time_s"] / faster, "found": found or row["found"]}
                    own["cc"] = row["cc"] if increase is None else (1 + increase) * row["exact_cc"]
                rows += [own] if name else []
    return rows


SAME = (1.0, None, None)
SLOW = (0.1, 0.5, 0.5)
BEST = (20.0, -0.1, 1.0)


def found_of(table, network, control=SLOW):
    if table == "2":
        return list(static.table2_findings(ours_like(paper.TABLE_2, network, control)))
    theirs = Rows({"found": 1.0, **row} for row in paper.TABLE_3)
    return list(dynamic.table3_findings(ours_like(theirs, network, control)))


@pytest.mark.parametrize("table", ["2", "3"])
def test_a_table_is_judged_by_the_figures(table):
    same = found_of(table, SAME)
    assert set(verdicts(same)) == {Verdict.AGREES}
    worse = [*filter(of_network, found_of(table, SLOW, BEST))]
    better = [*filter(of_network, found_of(table, BEST))]
    assert len(worse) == len(better) >= 5
    assert set(verdicts(worse)) == {Verdict.DIFFERS}
    assert set(verdicts(better)) == {Verdict.BETTER}
    assert not any(each.controls for each in (*filter(of_network, same), *worse, *better))


def of_network(finding):
    return "NN" in finding.claim and finding.claim.startswith(("speed-up", "CC increase"))


@pytest.mark.parametrize("table", ["2", "3"])
def test_a_verdict_that_a_control_earns_too_says_so(table):
    judged = [*filter(of_network, found_of(table, SAME, BEST))]
    for finding in judged:
        plain = "plain" in finding.claim
        assert finding.controls == (CONTROLS if plain else (CORRIDOR,))
    assert judged[0].cells[-1].startswith("corridor")
    fast_but_dear = filter(of_network, found_of(table, SAME, (20.0, 0.3, 1.0)))
    assert not any(each.controls for each in fast_but_dear)


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
