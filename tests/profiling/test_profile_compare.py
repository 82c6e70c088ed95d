"""Two reports beside each other: the same rule for better and for worse."""

import pytest

from nnpp_edge.profiling.compare import compare
from tests.tables import cases

OPPOSITE = {"better": "worse", "worse": "better", "same": "same"}


def report(key, value):
    """A report of one row with one figure."""
    spread, _, name = key.rpartition(".")
    figures = {spread: {name: value}} if spread else {key: value}
    row = {"workload": "soft", "size": 64, "planner": "nnpp", **figures}
    return {"results": [row], "disturbance": {"words": ""}, "sensors": {"throttled": ""}}


CHANGES = """
time_ms.median | 1.0   | 2.0   | 1.00 | worse
time_ms.median | 1.0   | 1.12  | 0.12 | worse
time_ms.median | 1.0   | 1.09  | 0.09 | same
time_ms.median | 0.004 | 0.008 | 1.00 | same
speedup_total  | 3.0   | 1.5   | 1.00 | worse
speedup_total  | 3.0   | 2.8   | 0.07 | same
gap_mean       | 0.0   | 0.01  |      | worse
gap_mean       | 0.01  | 0.02  | 1.00 | worse
success        | 0.98  | 0.96  | 1.00 | worse
success        | 1.0   | 0.99  |      | worse
"""
"""A figure, before and after, by which share it became worse, and the verdict at a tolerance of 0.1.
Backwards it became better by the same share."""


@pytest.mark.parametrize(("key", "before", "after", "change", "verdict"), cases(CHANGES, 5))
def test_a_figure_that_became_worse_is_better_by_the_same_share_the_other_way_round(
    key, before, after, change, verdict
):
    before = report(key, float(before))
    after = report(key, float(after))
    (line,) = compare(before, after, 0.1)["lines"]
    (back,) = compare(after, before, 0.1)["lines"]
    assert (line["verdict"], back["verdict"]) == (verdict, OPPOSITE[verdict])
    if change:
        assert line["change"] == pytest.approx(float(change), abs=0.005) == -back["change"]
    else:
        assert line["change"] is None is back["change"]
