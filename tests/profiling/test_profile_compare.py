"""Two reports beside each other: the figures of the first are budgets for the second."""

import pytest

from nnpp_edge.profiling.compare import compare
from tests.tables import cases


def report(key, value):
    """A report of one row with one figure."""
    spread, _, name = key.rpartition(".")
    figures = {spread: {name: value}} if spread else {key: value}
    row = {"workload": "soft", "size": 64, "planner": "nnpp", "halves": {}, **figures}
    return {
        "results": [row],
        "disturbance": {"words": "", "halves": [{"waited_share": 0.0, "others_share": None}]},
        "sensors": {"throttled": ""},
        "environment": {"cpu": "a"},
        "profile": {"load": {}, "networks": {}},
    }


CHANGES = """
time_ms.median | 1.0   | 2.0   | fail
time_ms.median | 1.0   | 1.12  | fail
time_ms.median | 1.0   | 1.09  | pass
time_ms.median | 0.004 | 0.008 | pass
speedup_total  | 3.0   | 1.5   | fail
speedup_total  | 3.0   | 2.8   | pass
gap_mean       | 0.0   | 0.01  | fail
gap_mean       | 0.01  | 0.02  | fail
success        | 0.98  | 0.96  | fail
success        | 1.0   | 0.99  | fail
"""
"""A figure, before and after, and the verdict at a tolerance of 0.1. Backwards it is kept."""


@pytest.mark.parametrize(("key", "before", "after", "verdict"), cases(CHANGES, 4))
def test_a_figure_may_become_worse_by_the_tolerance(key, before, after, verdict):
    before = report(key, float(before))
    after = report(key, float(after))
    (line,) = compare(before, after, 0.1)["budgets"]
    (back,) = compare(after, before, 0.1)["budgets"]
    assert (line["verdict"], back["verdict"]) == (verdict, "pass")
