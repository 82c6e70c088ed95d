"""Files of every format that the commands read, damaged or made up."""

import io
import itertools
import json
import random
import struct
import warnings
import zlib

import numpy as np

from tests.fuzz.cases import Place
from tests.fuzz.commands import Command
from tests.fuzz.mutations import junk_value, mutated, mutated_json, mutated_toml
from tests.fuzz.options import command_of, disturbed
from tests.fuzz.samples import COLS, DEMS, ROWS, heights, npy, npz

PLAN = "plan in/dem.npz --start 2,2 --goal 20,28"
MAP = "run --map in/dem.npz --method corridor"
_REPLAY = "--input replay:in/drive.jsonl --fast --output none"
_QUICK = "--queries 1 --methods astar --repeats 1"
_OF_DEM = (
    "costmap {f} -o out/cost.npz --json",
    "costmap {f} -o out/cost.tif",
    "plan {f} --start 2,2 --goal 20,28 --method astar -o out/plan --json",
    "plan {f} --start 2,2 --goal 20,28 --method corridor --workload limit20",
    f"run --map {{f}} {_REPLAY}",
    "simulate --map {f} --size 16 --ticks 3 --method astar --json",
    f"evaluate --terrain {{f}} --sizes 16 {_QUICK}",
)
_OF_DEM_SELDOM = (
    "dataset {f} -o out/set --maps 1 --size 32 --workers 1 --points 2",
    "profile --profile in/profile.toml --terrain {f} --sizes 16",
)
_TRAIN = "train in/set --steps 1 --input-size 64 --batch 2 --validate-every 0"


def generate(rng: random.Random, place: Place) -> Command:
    """A command that reads one damaged file."""
    kinds = {_dem: 6.0, _cost_map: 2.0, _recording: 2.0, _stdin: 2.0, _profile: 1.0, _model_notes: 0.7}
    if place.heavy:
        kinds |= {_report: 0.6, _data_set: 0.8, _checkpoint: 0.3}
    return disturbed(rng, rng.choices(list(kinds), list(kinds.values()))[0](rng, place))


def _reading(words: str, name: str, content: bytes, patient: bool = False) -> Command:
    """The command with the file in the place of ``{f}``."""
    return Command(tuple(words.format(f=name).split()), {name: content}, ("drive.jsonl",), patient=patient)


def _dem(rng: random.Random, place: Place) -> Command:
    name, kind = rng.choice(DEMS), rng.random()
    if kind < 0.5:
        others = tuple(place.sample(other)[:5000] for other in DEMS)
        content = mutated(rng, place.sample(name), others)
    elif kind < 0.6:
        content = place.sample(rng.choice((*DEMS, "cost.npz", "tiny.onnx", "drive.jsonl", "bomb.npz")))
    elif kind < 0.8:
        name = rng.choice(("dem.npz", "dem.npz", "dem.npy"))
        content = _odd_archive(rng) if name == "dem.npz" else _odd_array(rng)
    else:
        name, content = rng.choice((_odd_text, _odd_asc, _odd_png, _sparse, _odd_tif, _odd_tif))(rng, place)
    words = rng.choice(_OF_DEM if rng.random() < 0.95 else _OF_DEM_SELDOM)
    known = {parameter.name for parameter in command_of(words.split()[0]).params}
    words += " --cell-size 2" * ("cell_size" in known and rng.random() < 0.5)
    words += " --vertical-scale 0.01" * ("vertical_scale" in known and name.endswith("png"))
    return _reading(words, f"in/{name}", content, patient=name == "sparse.tif")  # 10¹⁰ cells take minutes


def _cost_map(rng: random.Random, place: Place) -> Command:
    kind = rng.random()
    content = place.sample("bomb-cost.npz") if kind < 0.05 else _odd_archive(rng, "cost")
    content = mutated(rng, place.sample("cost.npz")) if kind > 0.5 else content
    return _reading(f"run --map {{f}} {_REPLAY}", "in/cost.npz", content)


def _odd_array(rng: random.Random) -> bytes:
    """A .npy whose header is whole but odd, or says more than there is."""
    shapes = [
        (ROWS, COLS),
        (0, 5),
        (5, 0),
        (),
        (7,),
        (2, 3, 4),
        (1, 1),
        (10**9, 10**9),
        (-1, 5),
        (2**40,),
        (10**5,) * 2,
    ]
    shapes += ["x", None, [24, 32], (24.0, 32), (True, 2), (2**63, 1), (65536, 8192), *[(ROWS, COLS)] * 10]
    descrs: list[object] = str.split("<f4 >f4 <f8 <f2 <f16 |b1 |i1 |u1 <i8 >u2 <c8 |O |S4 <U4 <M8[s] junk |V0 <m8")
    descrs += [[("a", "<f4")], [("a", "<f4"), ("b", "<f4", (2,))], None, 5]
    known, kind = heights(rng.randrange(100)).astype("<f4"), rng.random()
    if kind < 0.3:
        value = np.float32(rng.choice((0.0, np.nan, np.inf, -np.inf, 1e-45, 3e38, -3e38, 1e9, 9.9e8)))
        known[np.random.default_rng(rng.getrandbits(32)).random(known.shape) < 0.5] = value
        return npy("<f4", (ROWS, COLS), known.tobytes())
    if kind < 0.37:
        header = rng.choice((b"(" * 9000, b"{" * 300, b"{'descr': " + b"-" * 9000 + b"1}", b"\xff" * 50, b"[]", b"1"))
        return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(header)) + header
    data = rng.choice((known.tobytes(), known.tobytes()[: rng.randrange(3000)], b"", known.tobytes() * 3))
    return npy(rng.choice(descrs), rng.choice(shapes), data, rng.choice((False, True, None, 1)))


def _odd_archive(rng: random.Random, only: str = "") -> bytes:
    """An .npz with the right names and odd values, or odd names."""
    grids = (only,) if only else ("elevation_m", "elevation", "dem", "z", "elevation_m", "cost")
    arrays = {f"{rng.choice(grids)}.npy": _odd_array(rng)}
    if rng.random() < 0.6:
        good = heights(rng.randrange(9))
        good = np.clip(np.abs(good), 0.0, 0.9) if only else good
        arrays = {f"{grids[0]}.npy": npy("<f4", (ROWS, COLS), good.astype("<f4").tobytes())}
    for name in ("cell_size_m", "cell_m", "cell_width_m"):
        value = rng.choice((2.0, 2.0, 0.0, -1.0, float("nan"), float("inf"), 1e-320, 1e300, -0.0, 1e-9, 5e-324))
        kinds = (*(npy("<f8", shape, struct.pack("<d", value)) for shape in ((), (1,))), _odd_array(rng))
        if rng.random() < 0.6:
            arrays[f"{name}.npy"] = rng.choices(kinds, (4, 1, 1))[0]
    if rng.random() < 0.1:
        arrays[rng.choice(("cell_size_m.npy", "x.txt", "../x.npy", "cell_size_m", "cost.npy"))] = rng.randbytes(30)
    return npz(arrays) if rng.random() < 0.8 else mutated(rng, npz(arrays))


def _odd_text(rng: random.Random, place: Place) -> tuple[str, bytes]:
    """A text that makes GDAL read something else."""
    files = ("/vsicurl/http://127.0.0.1:9/x.tif", "/etc/passwd", "../in/dem.tif", "/vsistdin/", "dem.tif")
    band = f"<SimpleSource><SourceFilename>{rng.choice(files)}</SourceFilename></SimpleSource>"
    band = f'<VRTRasterBand dataType="Float32" band="1">{band}</VRTRasterBand>'
    vrt = f'<VRTDataset rasterXSize="32" rasterYSize="24">{band}</VRTDataset>'
    wms = "<GDAL_WMS><Service name='TMS'><ServerUrl>http://127.0.0.1:9/${z}</ServerUrl></Service></GDAL_WMS>"
    return rng.choice(("dem.tif", "dem.vrt", "dem.asc", "dem.xyz")), rng.choice((vrt, wms)).encode()


def _odd_asc(rng: random.Random, place: Place) -> tuple[str, bytes]:
    words = {
        "ncols": "32",
        "nrows": "24",
        "xllcorner": "0",
        "yllcorner": "0",
        "cellsize": "2",
        "NODATA_value": "-9999",
    }
    words[rng.choice(list(words))] = rng.choice(str.split("0 -1 nan inf 1e9 1000000000 1e400 x 31 2147483648"))
    body = " ".join(f"{z:.2f}" for z in np.nan_to_num(heights(0, 24, 32)).ravel())
    return "dem.asc", ("\n".join(f"{k} {v}" for k, v in words.items()) + "\n" + body).encode()


def _odd_png(rng: random.Random, place: Place) -> tuple[str, bytes]:
    """A head that promises more, or less, than there is."""
    size = rng.choice((32, 2**31 - 1, 65535, 0)), rng.choice((24, 2**31 - 1, 0))
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", *size, 16, 0, 0, 0, 0))]
    chunks += [(b"IDAT", zlib.compress(bytes(24 * 65))), (b"IEND", b"")]
    parts = (
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )
    return "dem.png", b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _sparse(rng: random.Random, place: Place) -> tuple[str, bytes]:
    return "sparse.tif", place.sample("sparse.tif")


def _odd_tif(rng: random.Random, place: Place) -> tuple[str, bytes]:
    """A raster that a writer could have made."""
    import rasterio

    numbers = (2.0, 2.0, 0.0, -2.0, float("nan"), float("inf"), 1e-300, 1e300)
    sides, turns = [rng.choice(numbers) for _ in range(2)], [rng.choice((0, 0, 1.0)) for _ in range(2)]
    dtype = rng.choice(("float32", "float64", "int16", "uint8", "int32", "complex64", "float32", "int8"))
    kind = {"driver": "GTiff", "dtype": dtype, "count": rng.choice((1, 1, 1, 2, 5)), "height": ROWS}
    kind |= {"width": rng.choice((COLS, COLS, 1, 500)), "nodata": rng.choice((None, 0, None))}
    kind["transform"] = rasterio.Affine(sides[0], turns[0], 0, turns[1], sides[1], 9)
    if rng.random() < 0.5:
        kind["crs"] = rng.choice(("EPSG:4326", "EPSG:32633", "EPSG:3857", "EPSG:4978"))
    values = np.nan_to_num(np.resize(heights(), (kind["count"], ROWS, kind["width"]))).astype(dtype)
    with warnings.catch_warnings(), rasterio.MemoryFile() as memory:
        warnings.simplefilter("ignore")
        with memory.open(**kind) as dataset:
            dataset.write(values)
        return "dem.tif", bytes(memory.read())


def _recording(rng: random.Random, place: Place) -> Command:
    lines = place.sample("drive.jsonl").splitlines()
    for at in rng.sample(range(len(lines)), rng.choice((1, 2, 4))):
        lines[at] = rng.choice((mutated_json, mutated))(rng, lines[at])
    content = b"\n".join(lines) + rng.choice((b"\n", b"\n", b""))
    content = mutated(rng, content) if rng.random() < 0.1 else content
    content += b" " * (64 << 20) * (rng.random() < 0.02)
    words = f"{MAP} --input replay:{{f}} --fast --output {rng.choice(('none', 'stdout'))} "
    words += rng.choice(("", "", "--record out/again.jsonl", "--log out/drive.mcap"))
    return _reading(words, "in/played.jsonl", content)


def _stdin(rng: random.Random, place: Place) -> Command:
    lines = place.sample("messages.jsonl").splitlines()
    changes = (lambda rng, line: line, mutated_json, mutated)
    content = b"".join(rng.choice(changes)(rng, rng.choice(lines)) + b"\n" for _ in range(rng.randrange(12)))
    content = mutated(rng, content) if rng.random() < 0.3 else content
    words = f"{MAP} --rate 200 " + rng.choice(("", "", "--log out/x.mcap --record out/r"))
    return Command(tuple(words.split()), stdin=content, streams=("pipe", "pipe", "pipe"))


def _profile(rng: random.Random, place: Place) -> Command:
    content, measures = mutated_toml(rng, place.sample("profile.toml")), rng.random() < 0.2
    words = "profile --profile {f}" if measures else f"run --map in/dem.npz --profile {{f}} {_REPLAY}"
    return _reading(words, "in/own.toml", content, patient=measures)


def _model_notes(rng: random.Random, place: Place) -> Command:
    files = {"in/own.onnx": place.sample("tiny.onnx"), "in/own.md": place.sample("tiny.md")}
    files["in/own.json"] = rng.choice((mutated_json,) * 4 + (mutated,))(rng, place.sample("tiny.json"))
    if rng.random() < 0.3:
        files["in/own.md"] = mutated(rng, files["in/own.md"])
    words = rng.choice(("models in/own.onnx", "models in/own.onnx --json", f"{PLAN} --model in/own.onnx"))
    return Command(tuple(words.split()), files)


def _report(rng: random.Random, place: Place) -> Command:
    content = rng.choice((mutated_json,) * 4 + (mutated,))(rng, place.sample("report.json"))
    names = rng.choice(list(itertools.permutations(("in/own.json", "in/report.json"))))
    return Command(("profile", "compare", *names), {"in/own.json": content})


def _data_set(rng: random.Random, place: Place) -> Command:
    assert place.samples is not None
    name = rng.choice(("set32", "set"))
    shard = next((place.samples / name).glob("shard-*.npz")).name
    file = rng.choice(("dataset.json", "dataset.json", shard))
    content = place.sample(f"{name}/{file}")
    if file == "dataset.json" and rng.random() < 0.7:
        content = mutated_json(rng, content)
    elif file == "dataset.json" or rng.random() < 0.5:
        content = mutated(rng, content)
    else:
        content = _odd_shard(rng, content)
    words = rng.choice(
        (
            f"evaluate --dataset in/{name} {_QUICK}",
            f"dataset -o in/{name} --maps 2 --size {name[3:] or '64'} --points 2 --workers 1",
            f"{_TRAIN} --validation in/{name} -o out/run",
        )
    )
    return Command(tuple(words.split()), {f"in/{name}/{file}": content}, needs=("set", name))


def _odd_shard(rng: random.Random, content: bytes) -> bytes:
    """A shard one of whose arrays is cut, of another type or shape, or missing."""
    with np.load(io.BytesIO(content)) as shards:
        arrays = dict(shards)
    key = rng.choice(list(arrays))
    array = arrays.pop(key)
    numbers = array.dtype.kind in "iuf"
    odd = [array[:0], array[:1], array.ravel(), array[None], np.array(5)]
    odd += [array.astype(np.float64), np.full_like(array, 255)] if numbers else [array[::-1]]
    if rng.random() < 0.85:
        arrays[key] = rng.choice(odd)
    made = io.BytesIO()
    np.savez(made, **arrays)
    return made.getvalue()


def _checkpoint(rng: random.Random, place: Place) -> Command:
    content, kind = mutated(rng, place.sample("trained/checkpoint.pt")), rng.random()
    train = f"{_TRAIN} --validation in/set"
    if kind < 0.4:
        return Command(("export", "in/own.pt", "-o", "out/net.onnx"), {"in/own.pt": content})
    if kind < 0.7:
        return Command(tuple(f"{train} -o out/run --begin-with in/own.pt".split()), {"in/own.pt": content})
    history = json.dumps([{"step": junk_value(rng)}]).encode()
    files = {"in/trained/checkpoint.pt": content, "in/trained/history.json": history}
    return Command(tuple(f"{train} -o in/trained".split()), files, needs=("trained",))
