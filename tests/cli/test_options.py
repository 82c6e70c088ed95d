"""What every command does with options: how many, and their ranges."""

import importlib

import click
import numpy as np
import pytest

from nnpp_edge.cli.main import COMMANDS
from nnpp_edge.cli.options import Memory
from nnpp_edge.runtime import Counters
from nnpp_edge.runtime.options import PlanOptions, StepOptions

MOST_PARAMETERS = 30
"""Of a command. Only ever lowered."""


def commands():
    """Every command, by its name."""
    return {name: importlib.import_module(f"nnpp_edge.cli.{name}").command for name in COMMANDS}


def test_no_command_takes_many_parameters():
    assert max((len(command.params), name) for name, command in commands().items()) < (
        MOST_PARAMETERS + 1,
        "",
    )


@pytest.mark.parametrize(
    ("word", "count"), [("2GB", 2e9), ("500 MiB", 500 * 2**20), ("1.5k", 1500), ("7", 7)]
)
def test_a_size_counts_bytes_by_thousands_or_with_an_i_by_1024(word, count):
    assert Memory.__metadata__[0].parse(word) == count


def test_all_commands_that_plan_take_the_options_of_a_step_in_the_same_words():
    found = {
        name: {each.name: each for each in command.params} for name, command in commands().items()
    }
    for name, annotation in StepOptions.__annotations__.items():
        meant = annotation.__metadata__[0].description
        for command in ("plan", "view", "reach", "evaluate", "simulate", "run"):
            option = found[command][name]
            assert (option.help, option.default) == (meant, None), (command, name)
    for name, annotation in PlanOptions.__annotations__.items():
        assert (name in found["plan"]) == ("description=" in str(annotation)), name


def test_options_of_a_step_that_are_given_reach_the_loop_and_the_simulated_drive(
    run, told, monkeypatch
):
    np.savez("cost.npz", cost=np.full((12, 14), 0.25, np.float32), cell_size_m=1.0)
    settings = []
    monkeypatch.setattr(
        "nnpp_edge.robot.operations.onboard.run",
        lambda ground, wiring, loop, **_: settings.append(loop) or Counters(),
    )
    run("run --map cost.npz --omega 0.02 --no-corner-cutting --loop snap_radius=5 --method astar")
    run("run --map cost.npz --loop omega=0.03 --loop corner_cutting=false --method astar")
    assert [(each.omega, each.corner_cutting, each.snap_radius) for each in settings] == [
        (0.02, False, 5),
        (0.03, False, 3),
    ]
    drive = "simulate --size 32 --ticks 1 --method astar --workload soft"
    costs = {
        words: told(f"{drive} {words}", code=1)["optimal_cost"]
        for words in ("", "--omega 0.011 --corner-cutting", "--omega 0.05")
    }
    plain, same, other = costs.values()
    assert plain == same < other


def test_no_number_that_could_overflow_is_taken():
    kinds = {}
    for name, command in commands().items():
        for parameter in command.params:
            assert parameter.type not in (click.INT, click.FLOAT), (
                f"{name} {parameter.name} has no range"
            )
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
