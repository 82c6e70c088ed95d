"""Options of every command, drawn from what click knows of them: a new option is drawn without being listed here."""

import math
import random
from dataclasses import replace

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.main import COMMANDS, cli
from tests.fuzz.commands import Command
from tests.fuzz.mutations import NUMBERS, PAIRS, SIZES, WORDS

NAME = "options"
Values = dict[str, list[str]]
"""Words given for each parameter, by its name; a flag that is set has none."""

BASES: dict[str, list[Values]] = {
    "costmap": [
        {"dem": ["in/dem.npz"], "output": ["out/cost.npz"]},
        {"dem": ["in/dem.tif"], "output": ["out/c.tif"]},
    ],
    "plan": [
        {"dem": ["in/dem.npz"], "start": ["2,2"], "goals": ["20,28"]},
        {"dem": ["in/dem.tif"], "start": ["xy:1005,1995"], "goals": ["xy:1050,1960"], "output": ["out/plan"]},
        {"dem": ["in/dem.npz"], "start": ["2,2"], "goals": ["20,28"], "method": ["nnpp"], "model": ["in/tiny.onnx"]},
    ],
    "reach": [
        {"dem": ["in/dem.npz"], "start": ["2,2"], "within_cost": ["20"]},
        {"dem": ["in/dem.tif"], "start": ["2,2"], "within_cost": ["9"], "output": ["out/reach"]},
    ],
    "dataset": [{"output": ["out/set"], "maps": ["1"], "size": ["32"], "points_per_map": ["2"], "workers": ["1"]}],
    "train": [
        {"dataset": ["in/set"], "validation": ["in/set"], "output": ["out/run"], "steps": ["1"], "batch": ["2"]}
        | {"input_size": ["64"], "validate_every": ["0"]}
    ],
    "export": [{"checkpoint": ["in/trained/checkpoint.pt"], "output": ["out/net.onnx"]}],
    "quantize": [{"model": ["in/edge64.onnx"], "dataset": ["in/set"], "output": ["out/int8.onnx"], "samples": ["2"]}],
    "evaluate": [
        {"synthetic": [], "sizes": ["16"], "queries": ["1"], "repeats": ["1"], "methods": ["astar"]},
        {
            "terrain": ["in/dem.npz"],
            "sizes": ["16"],
            "queries": ["1"],
            "repeats": ["1"],
            "methods": ["astar,corridor"],
        },
    ],
    "reproduce": [{"experiments": ["table9"], "quick": [], "output": ["out/paper"]}],
    "profile": [{"profile_name": ["in/profile.toml"]}, {"peers": [], "sizes": ["16"], "queries": ["1"]}],
    "profile compare": [{"before": ["in/report.json"], "after": ["in/report.json"]}],
    "simulate": [
        {"dem": ["in/dem.npz"], "size": ["16"], "ticks": ["3"], "method": ["astar"]},
        {"dem": ["in/dem.npz"], "size": ["24"], "ticks": ["3"], "method": ["corridor"], "log": ["out/drive.mcap"]},
        {"size": ["32"], "ticks": ["3"], "method": ["corridor"], "vehicle": ["small-rover"], "rocks": ["0.02"]},
    ],
    "run": [
        {"map_file": ["in/dem.npz"], "input": ["replay:in/drive.jsonl"], "fast": [], "outputs": ["none"]},
        {"map_file": ["in/cost.npz"], "input": ["stdin"], "ticks": ["3"], "rate_hz": ["200"], "method": ["corridor"]},
    ],
    "models": [{"model": ["in/tiny.onnx"]}, {}],
    "warmup": [{"keep_old": []}],
}
"""For each command what makes it end well and soon; the cases depart from these."""
_PLACES = (
    "xy:1005,1995",
    "xy:nan,1",
    "xy:1",
    "lonlat:1,2",
    "lonlat:-94,45",
    "in/dem.npz",
    "in/dem.tif:a",
    ":",
    "xy:,",
)
_TIMES = ("9", "90s", "1min", "2h", "-3s", "1e9h", "soon", "0")
HEAVY = ("train", "export", "quantize", "profile compare")
"""Commands whose samples must be trained or measured first."""
SELDOM = {
    "reproduce": 0.15,
    "export": 0.1,
    "quantize": 0.1,
    "train": 0.25,
    "profile": 0.1,
    "evaluate": 0.6,
    "warmup": 0.2,
}
_INPUTS = ("in/dem.npz", "in/dem.npy", "in/dem.tif", "in/dem.png", "in/dem.asc", "in/cost.npz", "in/drive.jsonl")
_INPUTS += (
    "in/profile.toml",
    "in/tiny.onnx",
    "in/dem.img",
    "in/sparse.tif",
    "in/bomb.npz",
    "in/set32",
)
_ODD_INPUTS = ("", ".", "/", "in", "missing", "odd/loop", "odd/" + "x" * 300, "y/" * 2500, "in/dem.npz/x", "odd/null")
_ODD_INPUTS += ("odd/zero", "odd/locked/dem.npz", "odd/link", "~", "in/\x01", "in/\udcff.npz", "/proc/self/mem")
_ENDINGS = (
    ".tif",
    ".tiff",
    ".npy",
    ".npz",
    ".png",
    ".gif",
    ".json",
    ".jsonl",
    ".mcap",
    ".onnx",
    ".html",
    ".rrd",
    "",
    ".X",
)
_ODD_OUTPUTS = (
    "",
    ".",
    "out",
    "odd/loop",
    "odd/full",
    "odd/null",
    "in/dem.npz/x.png",
    "odd/" + "x" * 300,
    "odd/link",
)
_ODD_OUTPUTS += ("/proc/none/x", "odd/locked/x", "old/old.png", "old/old.npz", "old/old.json", "y/" * 2500 + "x")


def command_of(name: str) -> click.Command:
    """The click command of a name, which may have two words."""
    found: click.Command = cli
    for word in name.split():
        assert isinstance(found, click.Group)
        inner = found.get_command(click.Context(found), word)
        assert inner is not None
        found = inner
    return found


def names() -> list[str]:
    """Every command, those of groups as two words."""
    found = []
    for name in COMMANDS:
        if name == "view":  # it serves until it is stopped
            continue
        found.append(name)
        command = command_of(name)
        if isinstance(command, click.Group):
            found += [f"{name} {inner}" for inner in command.list_commands(click.Context(command))]
    return found


def generate(rng: random.Random, heavy: bool = True) -> Command:
    """A command with some of its options set to what may or may not make sense."""
    known = [name for name in names() if heavy or name not in HEAVY]
    name = rng.choices(known, [SELDOM.get(name, 1.0) for name in known])[0]
    return drawn(rng, name, heavy)


def drawn(rng: random.Random, name: str, heavy: bool = True) -> Command:
    """A case of one command."""
    command = command_of(name)
    values: Values = dict(rng.choice(BASES.get(name, [{}])))
    patient = False
    for _ in range(rng.choice((0, 1, 1, 1, 2, 2, 3, 5))):
        parameter = rng.choice(command.params)
        assert parameter.name is not None
        if parameter.name in values and rng.random() < 0.08:
            del values[parameter.name]
            continue
        given, long = draw_value(rng, parameter, values)
        values[parameter.name] = given
        patient = patient or long
    words = words_of(name, command, values)
    if rng.random() < 0.04:
        words.insert(
            rng.randrange(len(words) + 1), rng.choice(("--nope", "-h", "--help", "extra", "--json=1", "--", ""))
        )
    if name == "warmup" and "--keep-old" not in words:
        words.append("--keep-old")  # what others compiled is left alone
    found = Command(tuple(words), patient=patient or name in ("reproduce", "warmup") or _waits(values))
    links = {"odd/link": rng.choice(("../in/dem.npz", "../old/old.png", "nowhere", "../out"))}
    found = replace(found, links=links, needs=("dem.npz",))
    if name == "run":
        found = replace(found, stdin=_messages(rng), streams=("pipe", "pipe", "pipe"))
    return disturbed(rng, found)


def _waits(values: Values) -> bool:
    """Whether a loop's ticks come so seldom that all of them take longer than a case may."""
    try:
        (ticks,), (rate,) = values["ticks"], values.get("rate") or values["rate_hz"]
        return float(ticks) > 20.0 * float(rate)
    except (KeyError, ValueError):
        return False


def disturbed(rng: random.Random, command: Command) -> Command:
    """The same, now and then with standard streams that are closed, full or broken, a full disk, or fewer rights."""
    kind = rng.random()
    if kind < 0.12:
        stdin = "pipe" if command.stdin else rng.choice(("null", "closed"))
        out, err = (rng.choice(("pipe", "pipe", "closed", "full", "broken")) for _ in range(2))
        return replace(command, streams=(stdin, out, err))
    if kind < 0.17:
        return replace(command, file_bytes=rng.choice((0, 1, 100, 1000, 5000, 20_000)))
    if kind < 0.21:
        return replace(command, unprivileged=True)
    return command


def words_of(name: str, command: click.Command, values: Values) -> list[str]:
    """What a user would type."""
    words = name.split()
    for parameter in command.params:
        given = values.get(parameter.name or "")
        if given is None:
            continue
        if isinstance(parameter, click.Option):
            if not given:
                words.append(parameter.opts[-1])
            for word in given:
                words += [f"{parameter.opts[-1]}={word}"] if word.startswith("-") else [parameter.opts[-1], word]
    for parameter in command.params:
        if isinstance(parameter, click.Argument):
            words += [word for word in values.get(parameter.name or "", []) if word or name != "dataset"]
    return words


def draw_value(rng: random.Random, parameter: click.Parameter, values: Values) -> tuple[list[str], bool]:
    """Words for a parameter, and whether with them the command may rightly take long."""
    if isinstance(parameter, click.Option) and parameter.is_flag:
        return [], parameter.name in ("stay", "start_up")
    times = rng.choice((0, 1, 2, 3)) if parameter.multiple or parameter.nargs != 1 else 1
    words = [draw_word(rng, parameter, values) for _ in range(times)]
    return words, any(map(may_take_long, words))


def draw_word(rng: random.Random, parameter: click.Parameter, values: Values) -> str:
    """One word."""
    kind = parameter.type
    if isinstance(kind, click.Choice):
        return str(rng.choice(kind.choices)) if rng.random() < 0.8 else rng.choice(WORDS)
    if isinstance(kind, click.Path):
        return _path(rng, kind, values)
    if isinstance(kind, click.types.IntParamType | click.types.FloatParamType):
        whole = isinstance(kind, click.types.IntParamType)
        if rng.random() < 0.5:
            return str(rng.randrange(1, 40)) if whole else f"{10 ** rng.uniform(-2, 2):.3g}"
        return rng.choice(NUMBERS)
    if isinstance(kind, options.Parsed):
        pools = {"R,C": PAIRS, "N|RxC,…": SIZES, "N,…": PAIRS + NUMBERS, "PLACE": PAIRS + _PLACES, "TIME": _TIMES}
        pool = pools.get(kind.name, PAIRS + SIZES + WORDS) if rng.random() < 0.7 else PAIRS + SIZES + WORDS + NUMBERS
        return rng.choice(pool) if rng.random() < 0.7 else f"{rng.randrange(24)},{rng.randrange(32)}"
    if rng.random() < 0.4:
        path = _path(rng, options.PATH, values)
        return rng.choice(("", "", "replay:", "zenoh:")) + path
    return rng.choice(WORDS)


def _path(rng: random.Random, kind: click.Path, values: Values) -> str:
    """A name of a file or folder: to be read or, where the option says so, written."""
    if kind is options.NEW_FILE or (kind is options.FOLDER and rng.random() < 0.5):
        used = [word.removeprefix("replay:") for given in values.values() for word in given if "in/" in word]
        draw = rng.random()
        if draw < 0.2 and used and kind is options.NEW_FILE:
            return rng.choice(used)  # an output that is an input
        if draw < 0.5:
            return rng.choice(_ODD_OUTPUTS)
        return rng.choice(("out/new", "out/a/b/new", "new")) + rng.choice(_ENDINGS)
    return rng.choice(_INPUTS if rng.random() < 0.5 else _ODD_INPUTS)


def may_take_long(word: str) -> bool:
    """Whether a word holds a number with which a command may rightly run for long, or need much."""
    for part in word.replace("x", ",").replace("/", ",").split(","):
        try:
            number = abs(float(part))
        except ValueError:
            continue
        if not (number == 0.0 or 0.05 <= number <= 64.0) or math.isnan(number):
            return True
    return False


def _messages(rng: random.Random) -> bytes:
    """A little for stdin."""
    lines = (
        b'{"type":"pose","row":2,"col":2}',
        b'{"type":"goal","row":20,"col":28}',
        b"junk",
        b"[" * 500,
        b"",
        b"\xff",
    )
    return b"\n".join(rng.choices(lines, k=rng.randrange(8))) + rng.choice((b"", b"\n"))
