"""The budgets of a profile's report as JUnit XML, for others' continuous integration."""

import re
from collections import Counter
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from nnpp_edge.profiling.judge import FAIL, IN_WORDS, PASS, measured, place, wanted
from nnpp_edge.profiling.rows import Facts

_NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(report: Facts) -> bytes:
    """The budgets as JUnit XML: each a test, failed where it is missed, skipped where there is no
    telling.
    """
    # elements: junit-10.xsd of https://github.com/jenkinsci/xunit-plugin, which pytest keeps to as
    # well; GitLab shows an element's text, others its message
    name = _legal(f"nnpp-edge profile {report['profile']['name']}")
    budgets = report["budgets"]
    counts = Counter(line["verdict"] for line in budgets)
    words = {"tests": str(len(budgets)), "failures": str(counts[FAIL]), "errors": "0"}
    suites = Element("testsuites", words)
    skipped = str(len(budgets) - counts[PASS] - counts[FAIL])
    suite = SubElement(suites, "testsuite", words, name=name, skipped=skipped)
    suite.set("timestamp", _legal(report["made"]))
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
