"""What every command does with options: ranges, models that are not there, outputs that are inputs."""

import importlib
from pathlib import Path

import click
import numpy as np
import pytest

from nnpp_edge.cli.main import COMMANDS
from nnpp_edge.cli.removed import INSTEAD

MOST_PARAMETERS = 30
"""Of a command. Only ever lowered."""


def commands():
    """Every command, by its name."""
    return {name: importlib.import_module(f"nnpp_edge.cli.{name}").command for name in COMMANDS}


@pytest.fixture
def hills(tmp_path, monkeypatch):
    """A folder with a map, costs and a start."""
    monkeypatch.chdir(tmp_path)
    row, col = np.mgrid[0:60, 0:60]
    heights = (0.5 * np.sin(row / 7.0) * np.cos(col / 9.0)).astype(np.float32)
    np.savez("hills.npz", elevation_m=heights, cell_size_m=2.0)
    np.savez("costs.npz", cost=np.full((60, 60), 0.5), cell_size_m=2.0)
    return "hills.npz"


def test_no_command_takes_many_parameters():
    assert max((len(command.params), name) for name, command in commands().items()) < (MOST_PARAMETERS + 1, "")


def test_no_number_that_could_overflow_is_taken():
    kinds = {}
    for name, command in commands().items():
        for parameter in command.params:
            assert parameter.type not in (click.INT, click.FLOAT), f"{name} {parameter.name} has no range"
            if isinstance(parameter.type, click.IntRange | click.FloatRange):
                kinds[repr(parameter.type)] = command, parameter
    for command, option in kinds.values():
        for number in ("nan", "inf", "-inf", "1e308", "-1e308", "9" * 40, "-1", "1e-400"):
            try:
                taken = option.type.convert(number, option, click.Context(command))
            except click.BadParameter as error:
                assert "\n" not in error.format_message()
            else:
                assert 0.0 <= taken <= 2**32, (option.name, number)


def test_a_removed_option_says_what_to_write_instead(nnpp_edge):
    taken = {option: name for name, each in commands().items() for p in each.params for option in p.opts}
    for option, instead in INSTEAD.items():
        *command, name = option.split()
        ended = nnpp_edge(command[0] if command else "plan", f"{name}=1")
        ended.refused(f"{name} was removed: {instead}")
        assert ended.err.count("\n") == 1 and (command or name not in taken), option
    for words, complaint in (
        (("run", "--radius", "2"), "--radius was removed: write --set radius_m=VALUE"),
        (("dataset", "--clearance", "2"), "--clearance was removed: no network is trained for a vehicle"),
        (("run", "--picture", "2"), "no such option '--picture'"),
        (("plan", "--markdown"), "no such option '--markdown'"),
    ):
        nnpp_edge(*words).refused(complaint)


@pytest.mark.filterwarnings("error")
def test_cells_of_any_size_are_drawn(nnpp_edge, hills):
    for option in ("--cell-size", "--rescale"):
        for side in ("1e9", "1e-6"):
            ended = nnpp_edge("costmap", hills, "-o", "cost.npy", option, side)
            assert ended.code == 0 and "cost.png" in ended.out, ended.err
            assert Path("cost.png").stat().st_size > 1000
        nnpp_edge("costmap", hills, "-o", "cost.npy", option, "1e-9").refused("wanted cells with sides of 1e-06 to")
