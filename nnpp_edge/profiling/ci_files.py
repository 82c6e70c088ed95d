"""A profile's report in formats that others' continuous integration reads: Bencher Metric Format
and JUnit.
"""

import json
import math
import re
from collections import Counter
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from nnpp_edge.profiling.judge import (
    FAIL,
    IN_WORDS,
    PASS,
    measured,
    place,
    rows_by_place,
    value_of,
    wanted,
)
from nnpp_edge.profiling.quantities import QUANTITIES
from nnpp_edge.profiling.rows import Facts

_MEDIANS = {
    **{f"{basis}_ms": basis for basis in ("map", "patch", "reaction")},
    **{f"{basis}_ms_median": basis for basis in ("time", "inference")},
    "speedup_median": "ratio",
    "int8_speedup": "int8_ratio",
}
"""The quantities whose medians in both halves of the run a row holds, and their key."""
_NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def bmf(report: Facts) -> bytes:
    """Every figure as Bencher Metric Format, JSON: {benchmark: {measure: {value, …}}}.

    A benchmark is ``PROFILE/WORKLOAD/SIZE/PLANNER``, or ``PROFILE/whole run/PLANNER``; measures are
    quantities of budgets in their units. The bounds of a median are those of the run's halves.
    """
    # the schema: https://bencher.dev/bmf.json, of
    # https://bencher.dev/docs/reference/bencher-metric-format
    found: dict[str, Facts] = {}

    def add(where: str, quantity: str, figure: float | None, *bounds: float) -> None:
        scale = QUANTITIES[quantity].scale
        if figure is None or not all(map(math.isfinite, (figure, *bounds))):
            return
        metric = {"value": scale * figure}
        if bounds:
            metric["lower_value"] = scale * min(figure, *bounds)
            metric["upper_value"] = scale * max(figure, *bounds)
        found.setdefault(f"{report['profile']['name']}/{where}", {})[quantity] = metric

    for (workload, size, planner), row in rows_by_place(report["results"], report["loop"]).items():
        for quantity in QUANTITIES:
            halves = row["halves"].get(_MEDIANS.get(quantity), ())
            add(f"{workload}/{size}/{planner}", quantity, value_of(row, quantity), *halves)
    for quantity in QUANTITIES:
        for planner, figure in report["besides"].get(quantity, {}).items():
            add(f"whole run/{planner}", quantity, figure)
    return json.dumps(found, indent=1, allow_nan=False).encode()


def junit(report: Facts) -> bytes:
    """The budgets as JUnit XML: each a test, failed where it is missed, skipped where there is no
    telling.
    """
    # elements: junit-10.xsd of https://github.com/jenkinsci/xunit-plugin, which pytest keeps to as
    # well; GitLab shows an element's text, others its message
    name = _legal(f"nnpp-edge profile {report['profile']['name']}")
    budgets = report["budgets"]
    counts = Counter(line["verdict"] for line in budgets)
    totals = {"tests": len(budgets), "failures": counts[FAIL], "errors": 0}
    words = {key: str(count) for key, count in totals.items()}
    suites = Element("testsuites", words)
    skipped = str(len(budgets) - counts[PASS] - counts[FAIL])
    suite = SubElement(
        suites, "testsuite", words, name=name, skipped=skipped, timestamp=_legal(report["made"])
    )
    for line in budgets:
        # GitLab shows one test of a name
        title = f"{line['name']}: {line['quantity']}, {line['planner']}, {place(line)}"
        test = SubElement(suite, "testcase", name=_legal(title), classname=name)
        if line["verdict"] == PASS:
            continue
        said = f"{IN_WORDS[line['verdict']]}: measured {measured(line)}, wanted {wanted(line)}"
        message = _legal("; ".join(filter(None, (said, line["why"]))))
        kind = "failure" if line["verdict"] == FAIL else "skipped"
        SubElement(test, kind, type=line["verdict"], message=message).text = message
    indent(suites)
    content: bytes = tostring(suites, "utf-8", xml_declaration=True)
    return content


def _legal(text: str) -> str:
    """The text, with what XML cannot hold replaced."""
    return _NOT_IN_XML.sub("\ufffd", text)
