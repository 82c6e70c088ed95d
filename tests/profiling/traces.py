"""What a trace file must be for Perfetto to open it."""

import json
from collections import defaultdict


def check_trace(content):
    """Its complete events in order, after a look at the file's structure: names, nesting and sums of durations."""
    told = json.loads(content, parse_constant=lambda word: pytest_fail(word))
    events = told["traceEvents"]
    assert {event["ph"] for event in events} <= {"X", "C", "M"}
    names = {(event["name"], event["tid"]): event["args"]["name"] for event in events if event["ph"] == "M"}
    assert names["process_name", 0]
    spans = [event for event in events if event["ph"] == "X"]
    by_thread = defaultdict(list)
    for event in spans:
        assert event["ts"] >= 0.0 and event["dur"] >= 0.0
        by_thread[event["tid"]].append(event)
    for thread, of_thread in by_thread.items():
        assert names["thread_name", thread]
        check_nesting(of_thread)
    return spans


def check_nesting(spans):
    """Each begins no sooner than the one before and ends within those it stands in; what stands in one fits it."""
    open_spans, last = [], 0
    for event in spans:
        began, ended = ends_of(event)
        assert began >= last
        last = began
        while open_spans and open_spans[-1][1] <= began and (open_spans[-1][1], ended) != (began, began):
            open_spans.pop()
        if open_spans:
            assert ended <= open_spans[-1][1], event
            open_spans[-1][2] += ended - began
            assert open_spans[-1][2] <= open_spans[-1][1] - open_spans[-1][0]
        open_spans.append([began, ended, 0])


def ends_of(event):
    """Nanoseconds of begin and end."""
    began = round(1e3 * event["ts"])
    return began, began + round(1e3 * event["dur"])


def spans_of(spans, name):
    """Those whose name begins so."""
    return [event for event in spans if event["name"].startswith(name)]


def within(spans, whole):
    """Those that lie in it, in order."""
    began, ended = ends_of(whole)
    kept = [each for each in spans if each is not whole and each["tid"] == whole["tid"]]
    return [each for each in kept if began <= ends_of(each)[0] and ends_of(each)[1] <= ended]


def pytest_fail(word):
    """Infinity and NaN are no JSON."""
    raise AssertionError(word)
