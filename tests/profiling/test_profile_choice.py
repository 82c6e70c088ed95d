import json
import warnings

import numpy as np
import pytest

from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.planners import choice
from nnpp_edge.runtime.planners.choice import FORMAT, SHIPPED, SHIPPED_FOR_LARGE, Choice, choice_for, choice_path

GOOD = {
    "format": FORMAT,
    "measured": "2026-05-04",
    "machine": "board",
    "model": "edge",
    "rules": [
        {"size": 256, "from": 40, "method": "corridor"},
        {"size": 256, "from": 0, "method": "astar"},
        {"size": 1024, "from": 0, "method": "corridor"},
        {"size": 1024, "from": 500, "method": "nnpp"},
    ],
}


@pytest.fixture(autouse=True)
def no_home(monkeypatch, tmp_path):
    """Whatever this user has measured stays out of it."""
    monkeypatch.delenv("NNPP_EDGE_CHOICE", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    choice.saved_choice.cache_clear()
    yield
    choice.saved_choice.cache_clear()


@pytest.fixture
def save(monkeypatch, tmp_path):
    def save(content):
        path = tmp_path / "choice.json"
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        monkeypatch.setenv("NNPP_EDGE_CHOICE", str(path))
        choice.saved_choice.cache_clear()
        return path

    return save


def test_without_figures_the_shipped_ones_hold():
    assert choice_for((256, 256), "edge") is SHIPPED
    assert SHIPPED.pick(47)[0] == "astar" and SHIPPED.pick(48)[0] == SHIPPED.pick(5000)[0] == "corridor"
    assert choice_for((300, 2048), "edge") is SHIPPED_FOR_LARGE
    assert [SHIPPED_FOR_LARGE.pick(apart)[0] for apart in (47, 48, 511, 512)] == [
        "astar",
        "corridor",
        "corridor",
        "nnpp",
    ]
    assert choice_for((2048, 2048), "edge-joint") is SHIPPED


def test_a_planner_goes_by_the_figures_and_says_so(save):
    save(GOOD)
    planner = Planner(np.full((200, 240), 0.2, np.float32))
    near, far = planner.plan((0, 0), (0, 39)), planner.plan((0, 0), (40, 3))
    assert (near.method, far.method) == ("astar", "corridor")
    assert near.choice == "measured on this machine 2026-05-04: astar soonest from 0 cells at 256²"
    assert far.choice == "measured on this machine 2026-05-04: corridor soonest from 40 cells at 256²"


@pytest.mark.parametrize(("shape", "size"), [((10, 10), 256), ((500, 20), 256), ((20, 520), 1024), ((9999, 1), 1024)])
def test_the_nearest_measured_size_serves(save, shape, size):
    save(GOOD)
    assert f"at {size}²" in choice_for(shape, "edge").pick(9)[1]


def test_another_network_than_the_measured_one_is_not_chosen(save, tmp_path):
    save(GOOD)
    assert choice_for((1024, 1024), "edge").pick(600)[0] == "nnpp"
    method, reason = choice_for((1024, 1024), tmp_path / "other.onnx").pick(600)
    assert method == "corridor" and "with the network edge" in reason


def test_what_is_written_is_read_again(save):
    first = Choice.from_json(json.dumps(GOOD))
    assert Choice.from_json(first.to_json()) == first


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        "[]",
        json.dumps(GOOD | {"format": "other"}),
        json.dumps(GOOD | {"rules": []}),
        json.dumps(GOOD | {"rules": [{"size": 256, "from": 5, "method": "astar"}]}),
        json.dumps(GOOD | {"rules": [{"size": 256, "from": 0, "method": "auto"}]}),
        json.dumps(GOOD | {"rules": [{"size": 0, "from": 0, "method": "astar"}]}),
        json.dumps(GOOD | {"rules": [{"size": 256, "from": 0.5, "method": "astar"}]}),
        json.dumps(GOOD | {"rules": [{"size": 256, "method": "astar"}]}),
        json.dumps(GOOD | {"rules": [{"size": 256, "from": 0, "method": "astar"}] * 2}),
        json.dumps({key: GOOD[key] for key in ("format", "rules")}),
        json.dumps(GOOD | {"rules": 3}),
    ],
)
def test_a_bad_file_is_warned_of_once_and_the_shipped_figures_hold(save, content):
    path = save(content)
    with pytest.warns(UserWarning, match="auto goes by the shipped figures") as warned:
        assert choice_for((256, 256), "edge") is SHIPPED
        assert choice_for((512, 512), "edge") is SHIPPED
    assert len(warned) == 1
    told = str(warned[0].message)
    assert str(path) in told and "\n" not in told


def test_a_named_file_that_is_missing_is_warned_of_and_an_empty_name_is_not(monkeypatch, tmp_path):
    monkeypatch.setenv("NNPP_EDGE_CHOICE", str(tmp_path / "none.json"))
    with pytest.warns(UserWarning, match="no such file"):
        assert choice_for((256, 256), "edge") is SHIPPED
    monkeypatch.setenv("NNPP_EDGE_CHOICE", "")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert choice_for((256, 256), "edge") is SHIPPED


def test_where_the_file_lies(monkeypatch, tmp_path):
    assert choice_path() == tmp_path / "config" / "nnpp-edge" / "choice.json"
    monkeypatch.delenv("XDG_CONFIG_HOME")
    monkeypatch.setenv("HOME", "/home/rover")
    assert str(choice_path()) == "/home/rover/.config/nnpp-edge/choice.json"
    monkeypatch.delenv("HOME")
    assert choice_path() is None
