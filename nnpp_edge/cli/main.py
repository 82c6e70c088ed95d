"""The `nnpp-edge` command: its subcommands, imported when asked for, and how errors end."""

import functools
import io
import os
import sys
import warnings
from importlib import import_module
from pathlib import Path
from typing import NoReturn

import click

from nnpp_edge import __version__
from nnpp_edge.files import remove_empty_folders
from nnpp_edge.runtime.compiled import notice
from nnpp_edge.runtime.errors import NnppEdgeError, import_problem
from nnpp_edge.runtime.reading import reason

COMMANDS = {
    "costmap": "Traversability cost of an elevation map.",
    "plan": "Plan a path over an elevation map.",
    "view": "Plan on a map in the browser.",
    "reach": "Show what can be reached from a place.",
    "dataset": "Make a training set from terrain files.",
    "train": "Train a network.",
    "export": "Write a trained network as an ONNX model.",
    "quantize": "Make an int8 model, and measure whether it pays.",
    "learn": "Train a network on your own map, and tell whether it is worth keeping.",
    "evaluate": "Compare the planners on many queries.",
    "reproduce": "Repeat the paper's experiments and compare the figures.",
    "profile": "Measure the planners against budgets or other libraries.",
    "simulate": "Drive a simulated robot with the onboard loop.",
    "run": "Plan at a fixed rate, from messages to messages.",
    "ros": "Plan at a fixed rate, as a ROS 2 node.",
    "models": "List the shipped models, or show one in full.",
    "warmup": "Compile the kernels ahead of the first plan.",
}
"""Name and one line each; the command itself is `command` in the module of that name."""

_EXTRAS = {
    "geo": ("rasterio",),
    "ros": ("rclpy",),
    "robot": ("mcap", "zenoh"),
    "vector": ("pyogrio", "pyproj"),
    "train": ("torch", "onnx", "onnxscript", "safetensors"),
    "viz": ("jinja2", "matplotlib", "PIL"),
}
"""Packages that the onboard install lacks, by the extra that brings them."""


class LazyGroup(click.Group):
    """A group whose subcommands are imported one at a time: `--help` imports none."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        return import_module(f"nnpp_edge.cli.{name}").command if name in COMMANDS else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
)
@click.version_option(__version__, prog_name="nnpp-edge")
@click.pass_context
def cli(context: click.Context) -> None:
    """Learned path planning on a robot's own computer: elevation map in, safe and nearly optimal
    path out.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help(), err=True)
        context.exit(2)


def _show_warning(
    message: Warning | str, category: type[Warning], *_: object, **__: object
) -> None:
    if not issubclass(category, DeprecationWarning):
        _tell(f"warning: {message}")


def main() -> None:
    """Run the command. Wrong use and bad input end in one line and exit code 2, as does a stdout
    that is full.
    """
    _prepare_streams()
    warnings.showwarning = _show_warning
    notice.tell = functools.partial(click.echo, err=True)
    try:
        sys.exit(cli.main(prog_name="nnpp-edge", standalone_mode=False))
    except click.Abort:  # Ctrl-C
        click.echo("stopped", err=True)
        sys.exit(1)
    except click.UsageError as error:
        message = error.format_message()
        command = error.ctx.command_path if error.ctx else "nnpp-edge"
        _refuse(f"{message[0].lower()}{message[1:].rstrip('.')}; see {command} --help")
    except (NnppEdgeError, click.ClickException) as error:
        _refuse(str(error))
    except OSError as error:
        if error.filename is None:  # what is left for stdout would fail again at the end
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        name = error.filename or "a file or standard output"
        _refuse(f"{name}: could not be read or written ({reason(error)})")
    except MemoryError as error:
        _refuse(f"not enough memory ({error})" if str(error) else "not enough memory")
    except ImportError as error:
        package = (error.name or "").partition(".")[0]
        extra = next((extra for extra, names in _EXTRAS.items() if package in names), None)
        if extra is None:
            raise
        _refuse(f"this needs {import_problem(package, extra, error)}")
    finally:
        remove_empty_folders()


def _refuse(message: str) -> NoReturn:
    _tell(f"error: {message}")
    sys.exit(2)


def _tell(line: str) -> None:
    """Print a line on stderr; what a file's name brought along can neither break it nor steer a
    terminal.
    """
    printable = [each if each.isprintable() else repr(each)[1:-1] for each in line]
    click.echo("".join(printable), err=True)


def _prepare_streams() -> None:
    """Have streams that are closed swallow what is written, and those that cannot encode a
    character escape it. Streams that a test or another program has put in their place stay.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115  # as long as the process
        elif stream is getattr(sys, f"__{name}__"):
            stream.reconfigure(errors="backslashreplace")
            if name == "stderr":
                raw = io.BufferedWriter(_Log(2, "w", closefd=False))
                sys.stderr = io.TextIOWrapper(
                    raw, stream.encoding, "backslashreplace", line_buffering=True
                )


class _Log(io.FileIO):
    """Takes what cannot be written, too: a disk that is full under a log ends nothing."""

    def write(self, content: "io.ReadableBuffer", /) -> int:  # type: ignore[name-defined]
        try:
            return super().write(content) or 0
        except OSError:
            return len(memoryview(content).cast("B"))


if __name__ == "__main__":
    main()
