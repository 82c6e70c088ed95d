import json

from click.testing import CliRunner

from nnpp_edge.benchmarks import map_stage


def test_every_stage_is_timed_at_every_size(tiny_model):
    words = ["--size", "64", "--size", "96", "--repetitions", "2", "--model", str(tiny_model)]
    ended = CliRunner().invoke(map_stage.main, words, catch_exceptions=False)
    rows = json.loads(ended.stdout)
    assert [(row.pop("size"), row.pop("terrain")) for row in rows] == [(64, "synthetic"), (96, "synthetic")]
    for row in rows:
        assert {"copy", "cost map", "grid", "pyramid", "first path: nnpp, lazy"} <= set(row) and len(row) == 12
        assert min(row.values()) > 0.0
