import json

import numpy as np
import pytest
from click.testing import CliRunner

from nnpp_edge.benchmarks import soak as soaking
from nnpp_edge.benchmarks.soak import main, soak, soak_ground
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.ladder import NavigatorSettings
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.terrain.vehicle import Vehicle

BODY, DISC = Vehicle(length_m=1.5, width_m=1.2, clearance_m=0.3), Vehicle(radius_m=26.0)


def test_eight_hundred_ticks_leave_time_memory_and_paths_as_they_should_be():
    told = []
    row = soak(NavigatorSettings(method="auto"), soak_ground(128), ticks=800, changes=1, progress=told.append)
    assert (row["ticks"], row["invalid"], row["errors"]) == (800, 0, {})
    assert row["planned"] + row["kept"] + row["without_path"] == 800
    assert row["planned"] > 100
    assert row["reached"] >= 3
    assert row["without_path"] < 200
    assert row["rss_end_mb"] - row["rss_warm_mb"] < 5.0
    assert row["ticks_per_s"] == pytest.approx(1e3 / row["tick_ms"]["mean"])
    assert row["tick_ms"]["p50"] <= row["tick_ms"]["p99"] <= row["tick_ms"]["max"]
    assert told[-1] == 800


@pytest.mark.parametrize("method", ["astar", "dstar", "corridor", "corridor-dstar", "nnpp", "nnpp-dstar"])
def test_every_method_keeps_its_word(method, tiny_model):
    row = soak(
        NavigatorSettings(method=method, model=str(tiny_model)), soak_ground(48, 2), ticks=60, changes=2, seed=2
    )
    assert (row["invalid"], row["errors"]) == (0, {})
    assert row["planned"] > 3


@pytest.mark.parametrize("method", ["auto", "dstar", "corridor-dstar"])
def test_no_path_of_a_body_fails_the_newest_check(method):
    ground = soak_ground(64, vehicle=BODY, rocks=0.03)
    row = soak(NavigatorSettings(method=method), ground, ticks=150, changes=2)
    assert (row["invalid"], row["errors"]) == (0, {})
    assert row["planned"] > 50
    assert not np.array_equal(ground.true, ground.surveyed)


def test_no_line_of_a_disc_touches_what_it_must_not():
    row = soak(
        NavigatorSettings(method="auto", refine="any-angle"), soak_ground(64, vehicle=DISC), ticks=120, changes=2
    )
    assert (row["invalid"], row["errors"]) == (0, {})
    assert row["planned"] > 20


@pytest.mark.parametrize("vehicle", [None, BODY, DISC])
def test_a_path_through_an_obstacle_would_be_seen(monkeypatch, vehicle):
    tick = Navigator.tick

    def blind(self, deadline):
        """Answers with the first path for ever, moved to where the robot is."""
        if not hasattr(self, "first"):
            self.first = tick(self, deadline)
        return self.first

    monkeypatch.setattr(Navigator, "tick", blind)
    assert (
        soak(NavigatorSettings(method="astar"), soak_ground(64, vehicle=vehicle), ticks=200, changes=3)["invalid"] > 0
    )


def test_late_ticks_are_counted(monkeypatch):
    monkeypatch.setattr(soaking, "RATE_HZ", 1e9)
    assert soak(NavigatorSettings(method="astar"), soak_ground(48), ticks=20)["overruns"] == 20


def test_numbers_out_of_range_are_refused():
    for ticks, size in ((0, 64), (5, 8)):
        with pytest.raises(InvalidQueryError, match="soak needs"):
            soak(NavigatorSettings(method="auto"), soak_ground(size), ticks=ticks)
    with pytest.raises(InvalidQueryError, match="method"):
        soak(NavigatorSettings(method="fastest"), soak_ground(64), ticks=5)


def test_the_command_prints_what_came_of_it():
    words = "--ticks 30 --size 48 --method dstar --vehicle small-rover"
    ended = CliRunner().invoke(main, words.split())
    assert ended.exit_code == 0, ended.output
    row = json.loads(ended.stdout)
    assert row["method"] == "dstar" and np.isfinite(row["tick_ms"]["p99"]) and row["invalid"] == 0
