"""Every command with other options or a damaged file; options are drawn from what click knows,
without a list.
"""

import math
import random
import re
from dataclasses import replace

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.main import COMMANDS, cli
from tests.fuzz.cases import NOWHERE, Place
from tests.fuzz.commands import Command, check
from tests.fuzz.mutations import NUMBERS, WORDS, damaged
from tests.fuzz.samples import DEMS

__all__ = ["check"]
BASES = {
    "costmap": ("in/dem.npz -o out/cost.npz", "in/dem.tif -o out/c.tif"),
    "plan": (
        "in/dem.npz --start 2,2 --goal 20,28",
        "in/dem.tif --start xy:1005,1995 --goal xy:1050,1960 -o out/plan",
        "in/dem.npz --start 2,2 --goal 20,28 --method nnpp --model in/tiny.onnx",
    ),
    "reach": (
        "in/dem.npz --start 2,2 --within-cost 20",
        "in/dem.tif --start 2,2 --within-cost 9 -o out/reach",
    ),
    "dataset": (
        "in/dem.npz -o out/set --maps 1 --size 32 --points 2 --workers 1",
        "-o in/set --maps 2 --size 64 --points 2 --workers 1",
    ),
    "train": (
        "in/set --validation in/set -o out/run --steps 1 --batch 2 --input-size 64 "
        "--validate-every 0",
        "in/set --validation in/set -o in/trained --steps 1 --batch 2 --input-size 64 "
        "--validate-every 0",
    ),
    "export": ("in/trained/checkpoint.pt -o out/net.onnx",),
    "quantize": ("in/edge64.onnx --dataset in/set -o out/int8.onnx --samples 2",),
    "evaluate": (
        "--synthetic --sizes 16 --queries 1 --repeats 1 --methods astar",
        "--terrain in/dem.npz --sizes 16 --queries 1 --repeats 1 --methods astar,corridor",
        "--terrain in/dem.npz --sizes 16 --queries 1 --repeats 1 --methods nnpp --model "
        "in/tiny.onnx",
    ),
    "reproduce": ("table9 --quick -o out/paper",),
    "profile": ("--profile in/profile.toml", "--peers --sizes 16 --queries 1"),
    "profile compare": ("in/report.json in/another.json", "in/another.json in/report.json"),
    "profile render": (
        "in/report.json -o out/page.html",
        "in/report.json --junit out/budgets.xml --bmf out/figures.json",
    ),
    "simulate": (
        "--map in/dem.npz --size 16 --ticks 3 --method astar",
        "--map in/dem.npz --size 24 --ticks 3 --method corridor --log out/drive.mcap",
        "--size 32 --ticks 3 --method corridor --vehicle small-rover --rocks 0.02",
        "--map in/dem.npz --size 16 --ticks 3 --method nnpp-dstar --model in/tiny.onnx",
    ),
    "run": (
        "--map in/dem.npz --input replay:in/drive.jsonl --fast --output none",
        "--map in/cost.npz --input stdin --ticks 3 --rate 200 --method corridor",
        "--map in/dem.npz --input replay:in/drive.jsonl --fast --output stdout --record "
        "out/again.jsonl",
        "--map in/dem.npz --method nnpp --model in/tiny.onnx --input replay:in/drive.jsonl --fast "
        "--output none",
        "--map in/dem.npz --profile in/profile.toml --input replay:in/drive.jsonl --fast --output "
        "none",
        "--map in/dem.npz --method corridor --rate 200 --log out/x.mcap --record out/r",
    ),
    "models": ("in/tiny.onnx", ""),
    "warmup": ("--keep-old",),
}
"""For each command words with which it ends well and soon; the cases depart from these."""
INSIDE = {
    "set": ("set/dataset.json", "set/shard-00000.npz"),
    "tiny.onnx": ("tiny.onnx",) * 4 + ("tiny.json", "tiny.md"),
}
"""The files that are read where a word names these."""
SELDOM = {
    "reproduce": 0.15,
    "export": 0.1,
    "quantize": 0.1,
    "train": 0.25,
    "profile": 0.1,
    "evaluate": 0.6,
}
SELDOM |= {"warmup": 0.2}
_PLACES = (
    *str.split("1,2 0,0 -1,-1 1 1,2,3 , 1, 1.5,2 nan,nan inf,inf 1e308,1e308"),
    "9" * 20 + ",0",
)
_PLACES += (
    *str.split(
        "xy:1005,1995 xy:nan,1 xy:1 lonlat:1,2 lonlat:-94,45 in/dem.npz in/dem.tif:a : xy:,"
    ),
)
_SIZES = (
    *str.split("16 2 1 0 -5 16x16 2x40 1x1 x 16x 16,16 16x16x16 9 90s 1min 2h -3s 1e9h soon"),
    "9" * 12,
    "9" * 30,
)
_ODD_WORDS = (*_PLACES, *_SIZES, *WORDS, *NUMBERS)
_NAMES = (
    "dem.npz dem.npy dem.tif dem.png dem.asc cost.npz drive.jsonl profile.toml tiny.onnx dem.img"
)
_INPUTS = [f"in/{name}" for name in (*_NAMES.split(), "set")]
_ODD = ("", ".", "odd/loop", "odd/" + "x" * 300, "odd/null", "odd/link")
_ODD_INPUTS = (
    *_ODD,
    *str.split("/ in missing in/dem.npz/x odd/zero ~ /proc/self/mem"),
    "y/" * 2500,
    "in/\udcff.npz",
)
_ODD_OUTPUTS = (
    *_ODD,
    *str.split("out odd/full in/dem.npz/x.png /proc/none/x old/old.png old/old.npz"),
)
_ODD_OUTPUTS += ("old/old.json", "y/" * 2500 + "x")
_ENDINGS = (*str.split(".tif .tiff .npy .npz .png .gif .json .jsonl .mcap .onnx .html .rrd .X"), "")
_PATIENT = ("stay", "start_up", "ticks", "rate", "rate_hz")  # with these a command may rightly wait
_LINES = (
    b'{"type":"pose","row":2,"col":2}',
    b'{"type":"goal","row":20,"col":28}',
    b"junk",
    b"[" * 500,
    b"",
    b"\xff",
)


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
        command = command_of(name)
        inner = (
            command.list_commands(click.Context(command))
            if isinstance(command, click.Group)
            else []
        )
        found += [name, *(f"{name} {word}" for word in inner)]
    return found


def generate(rng: random.Random, place: Place = NOWHERE) -> Command:
    """A command with some of its options set to what may or may not make sense, or with a file
    damaged.
    """
    known = names()
    name = rng.choices(known, [SELDOM.get(name, 1.0) for name in known])[0]
    words = rng.choice(BASES.get(name, ("",))).split()
    patient = name in ("reproduce", "warmup")
    stdin = b"\n".join(rng.choices(_LINES, k=rng.randrange(8))) + rng.choice((b"", b"\n"))
    files: dict[str, bytes] = {}
    if place.samples is not None and rng.random() < 0.6:
        if name == "run" and not any("replay" in word for word in words):
            stdin = damaged(rng, place.sample("messages.jsonl"))
        else:
            words, files = _damage(rng, place, name, words)
        patient |= name == "profile"
    else:
        patient |= _redraw(rng, name, words)
    if name == "warmup":
        words.append("--keep-old")  # what others compiled is left alone
    link = rng.choice(("../in/dem.npz", "../old/old.png", "nowhere", "../out"))
    streams = ("pipe" if name == "run" else "null", "pipe", "pipe")
    found = Command((*name.split(), *words), files, needs=("dem.npz",), link=link, streams=streams)
    found = replace(found, stdin=stdin if name == "run" else b"", patient=patient)
    return disturbed(rng, found)


def _damage(
    rng: random.Random, place: Place, name: str, words: list[str]
) -> tuple[list[str], dict[str, bytes]]:
    """The words with a map of any format, and one of the files that they name, damaged or of
    another kind.
    """
    dem = rng.choice(DEMS)
    words = [re.sub(r"^in/dem\.\w+$", f"in/{dem}", word) for word in words]
    if dem in " ".join(words) and rng.random() < 0.5:
        words += ["--cell-size=2"] * any(
            each.name == "cell_size" for each in command_of(name).params
        )
    named = [each for each in re.findall(r"in/([\w./-]+)", " ".join(words)) if each != "trained"]
    if not named:
        return words, {}
    file = rng.choice([each for each in named for each in INSIDE.get(each, (each,))])
    if file in DEMS and rng.random() < 0.15:
        return words, {f"in/{file}": place.sample(rng.choice((*DEMS, "cost.npz", "tiny.onnx")))}
    return words, {f"in/{file}": damaged(rng, place.sample(file))}


def _redraw(rng: random.Random, name: str, words: list[str]) -> bool:
    """Change some of the words; whether the command may then take long."""
    patient = False
    if words and rng.random() < 0.08:
        del words[rng.randrange(len(words))]
    for _ in range(rng.choice((0, 1, 1, 1, 2, 2, 3, 5))):
        parameter = rng.choice(command_of(name).params)
        values = draw_values(rng, parameter, words)
        patient |= any(map(may_take_long, values)) or parameter.name in _PATIENT
        if isinstance(parameter, click.Option):
            option = parameter.opts[-1]
            words += [option] if parameter.is_flag else [f"{option}={value}" for value in values]
        else:
            at = next((at for at, word in enumerate(words) if word.startswith("in/")), len(words))
            words[at : at + 1] = values
    if rng.random() < 0.04:
        odd = rng.choice(("--nope", "-h", "--help", "extra", "--json=1", "--", ""))
        words.insert(rng.randrange(len(words) + 1), odd)
    return patient


def disturbed(rng: random.Random, command: Command) -> Command:
    """The same, now and then with standard streams that are closed, full or broken, or a
    full disk.
    """
    kind = rng.random()
    if kind < 0.12:
        stdin = "pipe" if command.stdin else rng.choice(("null", "closed"))
        out, err = (rng.choice(("pipe", "pipe", "closed", "full", "broken")) for _ in range(2))
        return replace(command, streams=(stdin, out, err))
    if kind < 0.17:
        return replace(command, file_bytes=rng.choice((0, 1, 100, 1000, 5000, 20_000)))
    return command


def draw_values(rng: random.Random, parameter: click.Parameter, used: list[str]) -> list[str]:
    """Values for a parameter: one, or several where it takes them."""
    times = rng.choice((0, 1, 2, 3)) if parameter.multiple or parameter.nargs != 1 else 1
    return [_draw_value(rng, parameter.type, used) for _ in range(times)]


def _draw_value(rng: random.Random, kind: click.ParamType, used: list[str]) -> str:
    if isinstance(kind, click.Choice):
        return str(rng.choice(kind.choices)) if rng.random() < 0.8 else rng.choice(WORDS)
    if isinstance(kind, click.Path):
        return _path(rng, kind, used)
    if isinstance(kind, click.types.IntParamType | click.types.FloatParamType):
        if rng.random() < 0.5:
            return rng.choice(NUMBERS)
        whole = isinstance(kind, click.types.IntParamType)
        return str(rng.randrange(1, 40)) if whole else f"{10 ** rng.uniform(-2, 2):.3g}"
    if isinstance(kind, options.SettingType):
        number = rng.choice(NUMBERS) if rng.random() < 0.5 else f"{10 ** rng.uniform(-2, 2):.3g}"
        return (
            f"{rng.choice(kind.keys())}={number}" if rng.random() < 0.8 else rng.choice(_ODD_WORDS)
        )
    if isinstance(kind, options.Parsed) and kind is not options.MODEL:
        pool = (
            {"N,…": _SIZES, "TIME": _SIZES}.get(kind.name, _PLACES)
            if rng.random() < 0.7
            else _ODD_WORDS
        )
        return (
            rng.choice(pool) if rng.random() < 0.7 else f"{rng.randrange(24)},{rng.randrange(32)}"
        )
    if rng.random() < 0.4:
        return rng.choice(("", "", "replay:", "zenoh:")) + _path(rng, options.PATH, used)
    return rng.choice(WORDS)


def _path(rng: random.Random, kind: click.Path, used: list[str]) -> str:
    """A name of a file or folder: to be read or, where the option says so, written."""
    if kind is options.NEW_FILE or (kind is options.FOLDER and rng.random() < 0.5):
        inputs = [word.removeprefix("replay:") for word in used if "in/" in word]
        draw = rng.random()
        if draw < 0.2 and inputs and kind is options.NEW_FILE:
            return rng.choice(inputs)  # an output that is an input
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
