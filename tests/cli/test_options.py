"""What every command does with options: how many, and their ranges."""

import importlib

import click

from nnpp_edge.cli.main import COMMANDS

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
