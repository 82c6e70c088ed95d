"""What every command does with options: ranges, models that are not there, outputs that are inputs."""

import importlib
import os
from pathlib import Path

import click
import numpy as np
import pytest

from nnpp_edge.cli.main import COMMANDS


def numeric_options():
    for name in COMMANDS:
        command = importlib.import_module(f"nnpp_edge.cli.{name}").command
        for option in command.params:
            if isinstance(option, click.Option) and isinstance(option.type, click.IntRange | click.FloatRange):
                yield pytest.param(command, option, id=f"{name} {option.opts[-1]}")


@pytest.fixture
def hills(tmp_path, monkeypatch):
    """A folder with a map, costs and a start."""
    monkeypatch.chdir(tmp_path)
    row, col = np.mgrid[0:60, 0:60]
    heights = (0.5 * np.sin(row / 7.0) * np.cos(col / 9.0)).astype(np.float32)
    np.savez("hills.npz", elevation_m=heights, cell_size_m=2.0)
    np.savez("costs.npz", cost=np.full((60, 60), 0.5), cell_size_m=2.0)
    return "hills.npz"


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_number_has_a_range(name):
    command = importlib.import_module(f"nnpp_edge.cli.{name}").command
    plain = [p.name for p in command.params if p.type in (click.INT, click.FLOAT)]
    assert plain == []


@pytest.mark.parametrize(("command", "option"), list(numeric_options()))
@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e308", "-1e308", "9" * 40, "-1", "1e-400"])
def test_no_number_that_could_overflow_is_taken(command, option, number):
    context = click.Context(command)
    try:
        taken = option.type.convert(number, option, context)
    except click.BadParameter as error:
        assert "\n" not in error.format_message()
    else:
        assert 0.0 <= taken <= 2**32


@pytest.mark.parametrize(
    "words",
    [
        ("run", "--map", "hills.npz", "--method", "astar", "--ticks", 1),
        ("plan", "hills.npz", "--start", "1,1", "--goal", "9,9", "--method", "astar"),
        ("simulate", "--map", "hills.npz", "--method", "astar"),
        ("evaluate", "--terrain", "hills.npz", "--methods", "astar"),
        ("reproduce", "table1", "--quick"),
    ],
    ids=lambda words: words[0],
)
def test_a_model_that_is_not_there_is_refused_even_where_none_is_needed(nnpp_edge, hills, words):
    nnpp_edge(*words, "--model", "nope").refused("wanted a model file or the name of a shipped model", "'nope'")
    assert {path.name for path in Path().iterdir()} == {"costs.npz", "hills.npz"}


def test_a_profile_whose_model_is_not_there_is_refused_even_where_none_is_needed(nnpp_edge, hills):
    Path("own.toml").write_text("[loop]\nmodel = 'nope'\nmethod = 'astar'\n")
    nnpp_edge("run", "--map", hills, "--profile", "own.toml", "--ticks", 1).refused("'nope'")


START = ("--start", "5,5", "--goal", "50,50", "--method", "astar")


@pytest.mark.parametrize(
    "words",
    [
        ("costmap", "hills.npz", "-o", "hills.npz"),
        ("costmap", "hills.npz", "-o", "link.npz"),
        ("costmap", "plan.png", "-o", "plan.npy", "--cell-size", 1, "--vertical-scale", 1),
        ("plan", "plan.png", *START, "-o", ".", "--cell-size", 1, "--vertical-scale", 1),
        ("evaluate", "--terrain", "hills.npz", "--plot", "hills.npz"),
        ("evaluate", "hills.npz", "--terrain", "plan.png", "--plot", "hills.npz"),
        ("evaluate", "--dataset", "set", "--plot", "set/dataset.json"),
        ("export", "hills.npz", "-o", "hills.npz"),
        ("quantize", "hills.npz", "--dataset", "set", "-o", "link.npz"),
        ("profile", "--profile", "report.json", "-o", "."),
        ("profile", "--peers", "--terrain", "peers.json", "-o", "."),
        ("simulate", "--map", "hills.npz", "--log", "hills.npz"),
        ("simulate", "--map", "plan.png", "--picture", "plan.png"),
        ("run", "--map", "hills.npz", "--metrics-file", "hills.npz"),
        ("run", "--map", "hills.npz", "--log", "link.npz"),
        ("run", "--map", "hills.npz", "--input", "replay:peers.json", "--metrics-file", "peers.json"),
        ("run", "--map", "hills.npz", "--profile", "own.toml", "--log", "own.toml"),
        ("run", "--map", "hills.npz", "--model", "peers.json", "--log", "peers.json"),
    ],
    ids=lambda words: " ".join(map(str, words)),
)
def test_an_output_never_replaces_an_input(nnpp_edge, hills, words):
    Path("link.npz").symlink_to("hills.npz")
    Path("set").mkdir()
    for name in ("plan.png", "peers.json", "set/dataset.json"):
        Path(name).write_text("input")
    for name in ("own.toml", "report.json"):
        Path(name).write_text("[workload]\nterrain = 'hills.npz'\n")
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    nnpp_edge(*words).refused("would replace", "which is read")
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("costmap", "hills.npz", "-o", "pipe.npy"), "it is a pipe"),
        (("run", "--map", "hills.npz", "--metrics-file", "pipe.npy"), "it is a pipe"),
        (("simulate", "--map", "hills.npz", "--log", "pipe.npy"), "it is a pipe"),
        (("evaluate", "--terrain", "hills.npz", "--plot", "pipe.npy"), "it is a pipe"),
        (("evaluate", "--terrain", "hills.npz", "--plot", "none/a.png"), "no such folder"),
        (("plan", "hills.npz", *START, "-o", "out"), "out/plan.json: could not be written (it is a folder)"),
        (("plan", "hills.npz", *START, "-o", "x" * 300), "File name too long"),
        (("plan", "hills.npz", *START, "-o", "loop"), "symbolic links"),
    ],
    ids=lambda words: " ".join(map(str, words))[:60] if isinstance(words, tuple) else None,
)
def test_an_output_that_cannot_be_written_is_refused_before_any_work(nnpp_edge, hills, monkeypatch, words, complaint):
    os.mkfifo("pipe.npy")
    Path("out/plan.json").mkdir(parents=True)
    Path("loop").symlink_to("loop")
    for work in ("terrain.dem.read_dem", "profiling.report.profile_machine"):
        monkeypatch.setattr(f"nnpp_edge.{work}", None)
    nnpp_edge(*words).refused(complaint)
    assert list(Path("out").iterdir()) == [Path("out/plan.json")]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("run", "--map", "hills.npz", "--cores", "4294967296"), "wanted cores of"),
        (("run", "--map", "hills.npz", "--cores", "99999"), "wanted cores of"),
        (("run", "--map", "hills.npz", "--rate", "1e-10"), "--rate"),
        (
            ("run", "--map", "hills.npz", "--output", "foo"),
            "output must be stdout, zenoh[:ENDPOINT] or none, got 'foo'",
        ),
        (("plan", "hills.npz", *START, "--omega", "1e308"), "--omega"),
        (("evaluate", "--synthetic", "--sizes", "999999999"), "sides of 2 to 32768 cells"),
        (
            ("profile", "compare", "none.json", "none.json"),
            "none.json: wanted a report of nnpp-edge profile (no such file)",
        ),
        (("simulate", "--seed", "-1"), "--seed"),
    ],
)
def test_numbers_and_names_out_of_range_are_one_line(nnpp_edge, hills, words, complaint):
    ended = nnpp_edge(*words)
    ended.refused(complaint)
    assert ended.err.count("\n") == 1


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "words", [("--cell-size", "1e9"), ("--cell-size", "1e-6"), ("--rescale", "1e9"), ("--rescale", "1e-6")]
)
def test_cells_of_any_size_are_drawn(nnpp_edge, hills, words):
    ended = nnpp_edge("costmap", hills, "-o", "cost.npy", *words)
    assert ended.code == 0, ended.err
    assert "cost.png" in ended.out and Path("cost.png").stat().st_size > 1000
    nnpp_edge("costmap", hills, "-o", "cost.npy", words[0], "1e-300").refused("sides of 1e-06 to 1e+09 m")


def test_a_place_beyond_all_maps_is_one_line(nnpp_edge, tmp_path):
    from nnpp_edge.terrain.dem import Dem, Georeference, write_raster

    heights = np.zeros((20, 20), np.float32)
    place = Georeference("EPSG:32615", (2.0, 0.0, 400_000.0, 0.0, -2.0, 5_000_000.0))
    write_raster(tmp_path / "dem.tif", heights, Dem(heights, 2.0, 2.0, place, tmp_path))
    for where in ("1e308,1e308", "-1e308,0"):
        nnpp_edge("plan", tmp_path / "dem.tif", "--start", f"xy:{where}", "--goal", "2,2").refused("near the map")
