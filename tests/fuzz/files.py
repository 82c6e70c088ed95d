"""Files of every format that the commands read, damaged; models among them."""

import random
from dataclasses import replace

from tests.fuzz.cases import Place
from tests.fuzz.commands import Command
from tests.fuzz.mutations import damaged
from tests.fuzz.options import command_of, disturbed
from tests.fuzz.samples import DEMS

_PLAN = "plan in/dem.npz --start 2,2 --goal 20,28"
_MAP = "run --map in/dem.npz --method corridor"
_REPLAY = "--input replay:in/drive.jsonl --fast --output none"
_QUICK = "--queries 1 --repeats 1 --methods"
_TRAIN = "train in/set --steps 1 --input-size 64 --batch 2 --validate-every 0 --validation in/set"
_READERS = (  # how often, the files of which one is damaged, and commands that read it
    (
        *(6.0, DEMS),
        "costmap {f} -o out/cost.npz --json",
        "costmap {f} -o out/cost.tif",
        "plan {f} --start 2,2 --goal 20,28 --method astar -o out/plan --json",
        "plan {f} --start 2,2 --goal 20,28 --method corridor --workload limit20",
        f"run --map {{f}} {_REPLAY}",
        "simulate --map {f} --size 16 --ticks 3 --method astar --json",
        f"evaluate --terrain {{f}} --sizes 16 {_QUICK} astar",
        "dataset {f} -o out/set --maps 1 --size 32 --workers 1 --points 2",
    ),
    (2.0, ("cost.npz",), f"run --map {{f}} {_REPLAY}"),
    (
        *(2.0, ("drive.jsonl",)),
        f"{_MAP} {_REPLAY}",
        f"{_MAP} --input replay:in/drive.jsonl --fast --output stdout --record out/again.jsonl",
        f"{_MAP} {_REPLAY} --log out/drive.mcap --metrics out/m",
    ),
    (2.0, ("messages.jsonl",), f"{_MAP} --rate 200", f"{_MAP} --rate 200 --log out/x.mcap --record out/r"),
    (1.0, ("profile.toml",), f"run --map in/dem.npz --profile {{f}} {_REPLAY}", "profile --profile {f}"),
    (0.7, ("tiny.json", "tiny.md"), "models in/tiny.onnx", "models in/tiny.onnx --json"),
    (
        *(5.0, ("tiny.onnx",)),
        f"{_PLAN} --method nnpp --model {{f}}",
        f"{_PLAN} --method auto --model {{f}} --json",
        "models {f} --json",
        f"run --map in/dem.npz --method nnpp --model {{f}} {_REPLAY}",
        "simulate --map in/dem.npz --size 16 --ticks 3 --method nnpp-dstar --model {f}",
        f"evaluate --terrain in/dem.npz --sizes 16 {_QUICK} nnpp --model {{f}}",
    ),
)
_TRAINED = (  # the same, of samples that are trained or measured
    (0.6, ("report.json",), "profile compare {f} in/another.json", "profile compare in/another.json {f}"),
    (
        *(0.8, ("set/dataset.json", "set/shard-00000.npz")),
        "dataset -o in/set --maps 2 --size 64 --points 2 --workers 1",
        f"{_TRAIN} -o out/run",
    ),
    (
        *(0.3, ("trained/checkpoint.pt", "trained/history.json")),
        "export in/trained/checkpoint.pt -o out/net.onnx",
        f"{_TRAIN} -o out/run --begin-with in/trained/checkpoint.pt",
        f"{_TRAIN} -o in/trained",
    ),
    (0.2, ("edge64.onnx",), f"{_PLAN} --model {{f}}", "quantize {f} --dataset in/set -o out/int8.onnx --samples 2"),
)


def generate(rng: random.Random, place: Place) -> Command:
    """A command that reads one damaged file."""
    readers = (*_READERS, *_TRAINED) if place.heavy else _READERS
    _, names, *commands = rng.choices(readers, [often for often, *_ in readers])[0]
    name, words = rng.choice(names), rng.choice(commands).format(f="{f}")
    swapped = names is DEMS and rng.random() < 0.15  # what is in it is of another kind
    other = rng.choice((*DEMS, "cost.npz", "tiny.onnx", "bomb.npz", "sparse.tif", "odd.vrt")) if swapped else name
    content = place.sample(other) if swapped else damaged(rng, place.sample(name))
    known = {parameter.name for parameter in command_of(words.split()[0]).params}
    words += " --cell-size 2" * (names is DEMS and "cell_size" in known and rng.random() < 0.5)
    patient = other == "sparse.tif" or words.startswith("profile --")  # 10¹⁰ cells take minutes
    command = Command(tuple(words.replace("{f}", f"in/{name}").split()), {f"in/{name}": content}, patient=patient)
    if name == "messages.jsonl":
        command = replace(command, files={}, stdin=content, streams=("pipe", "pipe", "pipe"))
    return disturbed(rng, command)
