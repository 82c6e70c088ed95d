"""Every command with other options or a damaged file; options are drawn from what click knows,
without a list.
"""

import contextlib
import re

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.main import cli
from tests.fuzz import commands
from tests.fuzz.commands import Command
from tests.fuzz.mutations import NUMBERS, WORDS, damaged
from tests.fuzz.samples import DEMS

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
        "in/set --validation in/set -o out/run --steps 1 --batch 2 --input-size 64 --validations 3",
        "in/set --validation in/set -o in/trained --steps 1 --batch 2 --input-size 64 "
        "--validations 3",
    ),
    "export": ("in/trained/best.pt -o out/net.onnx",),
    "learn": ("in/dem.npz -o out/own --maps 2 --time-limit 0.01 --queries 1",),
    "quantize": (
        "in/edge64.onnx --dataset in/set --validation in/set -o out/int8.onnx --samples 2",
    ),
    "evaluate": (
        "--synthetic --sizes 16 --queries 1 --repeats 1 --methods astar",
        "--terrain in/dem.npz --sizes 16 --queries 1 --repeats 1 --methods astar,corridor",
        "--terrain in/dem.npz --sizes 16 --queries 1 --repeats 1 --methods nnpp --model "
        "in/tiny.onnx",
    ),
    "reproduce": ("table9 --quick -o out/paper",),
    "profile": ("--profile in/profile.toml", "--peers --sizes 16 --queries 1"),
    "profile compare": ("in/report.json in/another.json", "in/another.json in/report.json"),
    "profile render": ("in/report.json -o out/page.html",),
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
    "warmup": ("--jobs 1",),
}
"""For each command words with which it ends well and soon; the cases depart from these."""
INSIDE = {
    "set": ("set/dataset.json", "set/shard-00000.npz"),
    "tiny.onnx": ("tiny.onnx",) * 4 + ("tiny.json", "tiny.md"),
}
"""The files that are read where a word names these."""
SELDOM = dict.fromkeys(("export", "quantize", "train", "profile", "reproduce", "warmup"), 0.15)
"""How often these slow commands are drawn, where others count 1."""
_PLACES = str.split(
    "1,2 0,0 -1,-1 1 1,2,3 , 1, 1.5,2 nan,nan inf,inf 1e308,1e308 99999999999999999999,0 "
    "xy:1005,1995 xy:nan,1 xy:1 lonlat:1,2 lonlat:-94,45 in/dem.npz in/dem.tif:a : xy:,"
)
_SIZES = str.split(
    "16 2 1 0 -5 16x16 2x40 1x1 x 16x 16,16 16x16x16 9 90s 1min 2h -3s 1e9h soon 999999999999 "
    "999999999999999999999999999999"
)
_ODD_WORDS = (*_PLACES, *_SIZES, *WORDS, *NUMBERS)
_INPUTS = str.split(
    "in/dem.npz in/dem.npy in/dem.tif in/dem.png in/dem.asc in/cost.npz in/drive.jsonl "
    "in/profile.toml in/tiny.onnx in/dem.img in/set"
)
_ODD = ["", *str.split(". odd/loop odd/null odd/link"), "odd/" + "x" * 300, "y/" * 2500 + "x"]
_ODD_INPUTS = [
    *_ODD,
    *str.split("/ in missing in/dem.npz/x odd/zero ~ /proc/self/mem in/\udcff.npz"),
]
_ODD_OUTPUTS = [
    *_ODD,
    *str.split("out odd/full in/dem.npz/x.png /proc/none/x old/old.png old/old.npz old/old.json"),
]
_ENDINGS = (*str.split(".tif .tiff .npy .npz .png .gif .json .jsonl .mcap .onnx .html .X"), "")
_PATIENT = ("stay", "ticks", "rate", "rate_hz")  # with these a command may rightly wait
_LINES = (
    b'{"type":"pose","row":2,"col":2}',
    b'{"type":"goal","row":20,"col":28}',
    b"junk",
    b"[" * 500,
    b"",
    b"\xff",
)


def command_of(name):
    """The click command of a name, which may have two words."""
    found = cli
    for word in name.split():
        assert isinstance(found, click.Group)
        found = found.get_command(click.Context(found), word) or found
    return found


def check(rng, place):
    """A command of which the samples are there."""
    commands.check(generate(rng, place), place)


def generate(rng, place):
    """A command with some of its options set to what may or may not make sense, or with a file
    damaged; now and then on a full disk.
    """
    name, base = rng.choices(*bases_at(place))[0]
    words = base.split()
    patient = name in ("reproduce", "warmup")
    files = {}
    stdin = b"\n".join(rng.choices(_LINES, k=rng.randrange(8)))
    if rng.random() < 0.4:
        patient |= _redraw(rng, name, words)
    elif name == "run" and rng.random() < 0.3:
        stdin = damaged(rng, place.sample("messages.jsonl"))
    else:
        files = _damage(rng, place, name, words)
        patient |= name == "profile"
    return Command(
        (*name.split(), *words),
        files,
        link=rng.choice(("../in/dem.npz", "../old/old.png", "nowhere", "../out")),
        stdin=stdin if name == "run" else b"",
        patient=patient,
        file_bytes=rng.choice((0, 1, 100, 1000, 5000, 20_000, *[256 << 20] * 100)),
    )


def bases_at(place):
    """Names and words of the commands whose samples have been made, and how often each is drawn."""
    found = {}
    for name, bases in BASES.items():
        for base in bases:
            named = re.findall(r"in/([\w.-]+)", base)
            if all((place.samples / each).exists() for each in named):
                found[name, base] = SELDOM.get(name, 1.0) / len(bases)
    return [*found], [*found.values()]


def _damage(rng, place, name, words):
    """A map of any format among the words; one of the files that they name, damaged or of another
    kind.
    """
    dem = rng.choice(DEMS)
    words[:] = [re.sub(r"^in/dem\.\w+$", f"in/{dem}", word) for word in words]
    takes_size = any(each.name == "cell_size" for each in command_of(name).params)
    if f"in/{dem}" in words and takes_size and rng.random() < 0.5:
        words.append("--cell-size=2")
    named = re.findall(r"in/(?!trained)([\w./-]+)", " ".join(words))
    if not named:
        return {}
    file = rng.choice([each for each in named for each in INSIDE.get(each, (each,))])
    content = place.sample(file)
    if file in DEMS and rng.random() < 0.15:
        return {f"in/{file}": place.sample(rng.choice((*DEMS, "cost.npz", "tiny.onnx")))}
    return {f"in/{file}": damaged(rng, content)}


def _redraw(rng, name, words):
    """Change some of the words; whether the command may then take long."""
    patient = False
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
    if words and rng.random() < 0.08:
        del words[rng.randrange(len(words))]
    return patient


def draw_values(rng, parameter, used):
    """Values for a parameter: one, or several where it takes them."""
    times = rng.choice((0, 1, 2, 3)) if parameter.multiple or parameter.nargs != 1 else 1
    return [_draw_value(rng, parameter.type, used) for _ in range(times)]


def _draw_value(rng, kind, used):
    if isinstance(kind, click.Path):
        return _path(rng, kind, used)
    usual = rng.random() < 0.6
    number = f"{10 ** rng.uniform(-2, 2):.3g}"
    if isinstance(kind, click.types.IntParamType):
        return str(rng.randrange(1, 40)) if usual else rng.choice(NUMBERS)
    if isinstance(kind, click.types.FloatParamType):
        return number if usual else rng.choice(NUMBERS)
    if isinstance(kind, click.Choice):
        return str(rng.choice(kind.choices)) if usual else rng.choice(WORDS)
    if isinstance(kind, options.SettingType):
        value = number if usual else rng.choice(NUMBERS)
        return rng.choice((f"{rng.choice(kind.keys())}={value}",) * 4 + (rng.choice(_ODD_WORDS),))
    if isinstance(kind, options.Parsed) and kind is not options.MODEL:
        known = _SIZES if kind.name in ("N,…", "TIME") else _PLACES
        cell = f"{rng.randrange(24)},{rng.randrange(32)}"
        return rng.choice((cell, rng.choice(known), rng.choice(known if usual else _ODD_WORDS)))
    if usual:
        return rng.choice(WORDS)
    return rng.choice(("", "", "replay:", "zenoh:")) + _path(rng, options.PATH, used)


def _path(rng, kind, used):
    """A name of a file or folder: to be read or, where the option says so, written."""
    written = kind is options.NEW_FILE
    if written or (kind is options.FOLDER and rng.random() < 0.5):
        inputs = [word.removeprefix("replay:") for word in used if "in/" in word]
        new = rng.choice(("out/new", "out/a/b/new", "new")) + rng.choice(_ENDINGS)
        odd = rng.choice(_ODD_OUTPUTS)
        an_input = rng.choice(inputs) if inputs and written else new
        return rng.choice((an_input, odd, odd, new, new))
    return rng.choice(_INPUTS if rng.random() < 0.5 else _ODD_INPUTS)


def may_take_long(word):
    """Whether a word holds a number with which a command may rightly run for long, or need much."""
    for part in re.split("[x/,]", word):
        with contextlib.suppress(ValueError):
            number = abs(float(part))
            if not (number == 0.0 or 0.05 <= number <= 64.0):  # nan is none of them
                return True
    return False
