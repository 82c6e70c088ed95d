"""What every command does with options: how many, their ranges, and those that were removed."""

import importlib

import click

from nnpp_edge.cli.main import COMMANDS
from nnpp_edge.cli.removed import INSTEAD

MOST_PARAMETERS = 30
"""Of a command. Only ever lowered."""


def commands():
    """Every command, by its name."""
    return {name: importlib.import_module(f"nnpp_edge.cli.{name}").command for name in COMMANDS}


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
