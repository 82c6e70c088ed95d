"""A report as people read it and in the formats of others' continuous integration."""

import json
import os
import re
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import click
import pytest
import yaml

from nnpp_edge.cli.profile import command
from nnpp_edge.cli.profile_text import report_text
from nnpp_edge.profiling.judge import EXIT_CODES, measured, summary
from nnpp_edge.profiling.junit import junit
from tests.tables import cases

COUNTS = {"tests", "failures", "errors"}
ATTRIBUTES = {
    "testsuites": COUNTS,
    "testsuite": {"name", "skipped", "timestamp", *COUNTS},
    "testcase": {"name", "classname"},
    "failure": {"type", "message"},
    "skipped": {"type", "message"},
}
"""Of each element; allowed by junit-10.xsd of https://github.com/jenkinsci/xunit-plugin."""


@pytest.fixture
def report():
    """A made-up one of two planners; its budgets have four verdicts."""
    return json.loads(Path(__file__).with_name("report.json").read_text())


def test_budgets_have_their_reasons_below_them_and_figures_with_units(report):
    text = report_text(report)
    lines = [line.split() for line in text.splitlines()]
    for words in ("ten a second nnpp soft 256² 2500/s ≥ 10/s KEPT", "memory nnpp whole run 150 MB"):
        assert any(line[: len(words.split())] == words.split() for line in lines)
    for line in report["budgets"]:
        assert (f"): {line['why']}\n" in text) == bool(line["why"])
    assert text.splitlines()[-1].startswith(
        "budgets missed: 3 kept, 1 missed, 1 noisy, 1 not measured; missed: "
    )
    assert "| ≤ 1 s | NOT MEASURED |" in report_text(report, markdown=True)


def test_the_machine_and_how_it_ran_are_told_as_far_as_known(report):
    _, _, machine = report_text(report).partition("Machine\n\n")
    for line in (
        "processor: A board",
        "clock meanwhile: 0: 1500 to 2400 MHz",
        "memory: 8.0 GiB",
        "others took: 40.0 %",
        "peak memory: nnpp 150 MB",
    ):
        assert f"{line}\n" in machine
    assert "temperature" not in machine


def test_a_name_of_several_lines_or_with_signs_of_tables_stays_in_its_row(report):
    report["budgets"][0]["name"] = "[/b] one\ntwo | :bug:"
    assert "[/b] one two | :bug: " in report_text(report)
    assert "| [/b] one two \\| :bug: | nnpp |" in report_text(report, markdown=True)


def test_a_figure_beside_its_limit_does_not_look_like_it(report):
    line = report["budgets"][1]
    assert measured(line) == "0.4004 %"
    assert measured(line | {"value": 0.4}) == "0.4 %"
    assert measured(line | {"value": 0.39}) == "0.39 %"


def test_the_summary_names_who_is_to_blame_by_verdict(report):
    unsure = [line for line in report["budgets"] if line["verdict"] != "fail"]
    assert summary("noisy", unsure, "") == (
        "too noisy to tell: 3 kept, 1 noisy, 1 not measured; "
        "noisy: faster than exact A* (nnpp, soft 256²); not measured: start (nnpp)"
    )


def test_budgets_are_tests_for_readers_of_junit(report):
    report["budgets"][4]["name"] = "memory \x01\ud800"
    root = ET.fromstring(junit(report))
    assert root.tag == "testsuites"
    assert all(set(element.keys()) == ATTRIBUTES[element.tag] for element in root.iter())
    (suite,) = root
    assert [suite.get(key) for key in ("tests", "failures", "skipped")] == ["6", "1", "2"]
    ends = {test.get("name").partition(":")[0]: [*test] for test in suite}
    assert len({test.get("name") for test in suite}) == 6 and not ends["memory \ufffd\ufffd"]
    ((kind, words),) = [(end.tag, end.text) for end in ends["mean <gap> | small"]]
    assert (kind, words) == ("failure", "missed: measured 0.4004 %, wanted ≤ 0.4 %")
    for name, reason in (
        ("faster than exact A*", "others took 40 %"),
        ("start", "did not measure"),
    ):
        (skipped,) = ends[name]
        assert skipped.tag == "skipped" and reason in skipped.text == skipped.get("message")


RECIPES = Path(__file__).parents[2] / "docs" / "profile-ci.md"
ATTEMPTS = """
0       | 0
1       | 1
2       | 2
3, 0    | 0
3, 3, 1 | 1
3, 3, 3 | 3
"""
"""Exit codes of the measurements, and that of the job."""


@pytest.fixture(scope="module")
def recipes():
    """The documented jobs of GitHub Actions and GitLab CI."""
    found = re.findall(r"```yaml\n(.*?)```", RECIPES.read_text(), re.DOTALL)
    return [yaml.safe_load(each) for each in found]


@pytest.mark.parametrize(("codes", "code"), cases(ATTEMPTS))
def test_the_documented_job_measures_again_where_there_is_no_verdict(
    recipes, tmp_path, codes, code
):
    (script,) = [step["run"] for step in recipes[0]["jobs"]["profile"]["steps"] if "name" in step]
    codes = codes.split(", ")
    for at, each in enumerate(codes):
        (tmp_path / f"code-{at}").write_text(each)
    program = tmp_path / "nnpp-edge"
    program.write_text("#!/bin/sh\necho $* >> calls\nexit $(cat code-$(($(wc -l < calls) - 1)))\n")
    program.chmod(0o755)
    path = {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    job = ["bash", "-e", "-c", script]
    ended = subprocess.run(job, cwd=tmp_path, env=os.environ | path, timeout=60)
    calls = (tmp_path / "calls").read_text().splitlines()
    assert (ended.returncode, len(calls)) == (int(code), len(codes))


def test_the_documented_jobs_give_options_that_there_are_and_upload_what_is_written(recipes):
    actions, gitlab = (json.dumps(recipe) for recipe in recipes)
    for recipe in (actions, gitlab):
        (words,) = re.findall(r"nnpp-edge profile ([^|\"\\]*)", recipe)
        given, *_ = command.make_parser(click.Context(command)).parse_args(words.split())
        assert given["junit"] == "budgets.xml"
    job = recipes[1]["profile"]
    assert job["retry"] == {"max": 2, "exit_codes": EXIT_CODES["noisy"]}
    assert job["artifacts"]["reports"]["junit"] == "budgets.xml"
    assert "report\\nbudgets.xml" in actions
