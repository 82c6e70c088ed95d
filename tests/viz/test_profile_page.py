"""The page of a profile's report."""

import json
import re
from pathlib import Path

import pytest

from nnpp_edge.viz.figures import page


@pytest.fixture
def report():
    return json.loads(Path(__file__).parents[1].joinpath("profiling/report.json").read_text())


def rows(text):
    """The cells of each row below the head of the table of budgets, by the budget's name."""
    table = text.partition('<table class="budgets">')[2].partition("</table>")[0]
    found = [re.findall("<td[^>]*>(.*)</td>", row) for row in table.split("<tr>")[1:]]
    return {cells[0]: cells[1:] for cells in found if cells}


def test_each_budget_has_its_figures_with_units_and_its_reason(report):
    text = page(report)
    of = rows(text)
    assert of["start"] == [
        *("nnpp", "whole run", "–", "≤ 1 s", "NOT MEASURED", "this run did not measure it")
    ]
    *figures, why = of["ten a second"]
    assert figures == ["nnpp", "soft 256²", "2500/s", "≥ 10/s", "KEPT"]
    assert "explains no such margin" in why and "halves 0.4 ms, 0.5 ms" in why
    assert "halves 2×, 2.1×" in of["faster than exact A*"][-1]
    assert of["mean &lt;gap&gt; | small"][-2:] == ["MISSED", ""]
    assert "missed: 3 kept, 1 missed, 1 noisy, 1 not measured" in text


def test_a_plot_over_sizes_needs_several(report):
    assert "Time against map size" not in page(report)
    report["results"] += [row | {"size": 512} for row in report["results"]]
    assert "Time against map size" in page(report)
