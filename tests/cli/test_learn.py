"""`nnpp-edge learn`: one's own ground in one line, stopped and gone on with."""

from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.cli import learn
from nnpp_edge.profiling.worth import KEEP, LEAVE, OPEN
from nnpp_edge.runtime.network.model_file import read_model_file

VERDICTS = (KEEP, OPEN, LEAVE)


@pytest.fixture
def dem(trained_on, monkeypatch):
    """dem.npz, a map of 80 × 160 cells; few queries judge the training."""
    monkeypatch.setattr("nnpp_edge.cli.learn.VALIDATED_ON", 12)
    return trained_on(80)


def test_a_map_without_room_for_a_stripe_is_refused_and_leaves_nothing(run, dem):
    wanted = "at least 64 cells across the stripe that --validation-share holds out"
    run("learn dem.npz -o me").refused(wanted, "got 40: (80, 160)")
    run("learn dem.npz -o me --workload limit20 --limit hard_slope_deg=9").refused(
        "leave out --limit"
    )
    assert not Path("me").exists()


def test_steps_say_all_that_they_need_and_the_int8_model_is_compared(run, monkeypatch):
    made = []

    def printed(words):
        made.append(words)
        if words[0] == "train":
            Path("own/run").mkdir(parents=True)
            Path("own/run/best.pt").touch()
        return "made"

    monkeypatch.setattr("nnpp_edge.cli.learn.output_of", printed)
    monkeypatch.setattr("nnpp_edge.cli.learn._compared", lambda network, *_: f"by {network}")
    np.savez("dem.npz", elevation_m=np.zeros((512, 128), np.float32), cell_size_m=1.0)
    ended = run("learn dem.npz -o own")
    assert ended.code == 0, ended.err
    assert ended.out.splitlines()[-1] == "by own/int8.onnx"
    assert [words.count("--size") for words in made] == [1, 1, 0, 0, 0]


@pytest.mark.slow
def test_one_line_leads_from_a_map_to_a_verdict_and_goes_on_where_it_was_stopped(
    run, dem, monkeypatch
):
    words = (
        "learn dem.npz -o me --validation-share 0.4 --maps 12 --time-limit 0.01 --workload limit30 "
        "--omega 0.02"
    )
    ended = run(f"{words} --queries 4")
    assert ended.code == 0, ended.err
    lines = [line for line in ended.out.splitlines() if line.startswith("[")]
    made = "dataset dataset train export quantize"
    assert [line.split()[2] for line in lines[:5]] == made.split()
    assert "--held-out" in lines[1] and "--workload limit30" in lines[0]
    assert "verdict: " in ended.out.splitlines()[-1]
    stamps = {path: path.stat().st_mtime_ns for path in Path("me").rglob("*.np*")}
    weights = Path("me/run/best.pt").read_bytes()
    assert len(stamps) >= 2
    found = read_model_file(Path("me/int8.onnx")).metadata
    limit = found.cost_limits["hard_slope_deg"]
    assert (found.name, found.precision, found.omega, limit) == ("own", "int8", 0.02, 30.0)
    assert found.training["dataset"]["cell_sizes_m"] == []

    def without_models(words, output_of=learn.output_of):
        return output_of(words) if words[0] in ("dataset", "train") else ""

    monkeypatch.setattr(learn, "output_of", without_models)
    more = run(f"{words} --queries 5 --json")
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps, "made again"
    assert Path("me/run/best.pt").read_bytes() == weights, "trained on"
    told = more.json
    assert told["verdict"].startswith(VERDICTS)
    others = ["corridor", "edge", "corridor-narrow", "nnpp-untrained"]
    assert [each["other"] for each in told["beside"]] == others
    assert sorted(told["rows"]) == sorted([*others, "astar", "own"])
    assert told["rows"]["own"]["n"] == 5
    assert "queries on maps of 64 × 64 cells" in ended.out
    assert lines[0] in more.err
