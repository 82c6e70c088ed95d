"""Files of every format that the commands read, damaged or made up."""

import io
import json
import random
import struct
from pathlib import Path

import numpy as np

from tests.fuzz.commands import Command
from tests.fuzz.mutations import junk_value, mutated, mutated_json, mutated_toml
from tests.fuzz.options import command_of, disturbed
from tests.fuzz.samples import COLS, DEMS, ROWS, heights, npy, npz

NAME = "files"
_REPLAY = ("--input", "replay:in/drive.jsonl", "--fast", "--output", "none")
_OF_DEM = (
    ("costmap", "{f}", "-o", "out/cost.npz", "--json"),
    ("costmap", "{f}", "-o", "out/cost.tif"),
    ("plan", "{f}", "--start", "2,2", "--goal", "20,28", "--method", "astar", "-o", "out/plan", "--json"),
    ("plan", "{f}", "--start", "2,2", "--goal", "20,28", "--method", "corridor", "--workload", "limit20"),
    ("run", "--map", "{f}", *_REPLAY),
    ("simulate", "--map", "{f}", "--size", "16", "--ticks", "3", "--method", "astar", "--json"),
    ("evaluate", "--terrain", "{f}", "--sizes", "16", "--queries", "1", "--methods", "astar", "--repeats", "1"),
)
_OF_DEM_SELDOM = (
    ("dataset", "{f}", "-o", "out/set", "--maps", "1", "--size", "32", "--workers", "1", "--points", "2"),
    ("profile", "--profile", "in/profile.toml", "--terrain", "{f}", "--sizes", "16"),
)
MAP = ("run", "--map", "in/dem.npz", "--method", "corridor")
_ONE_STEP = ("--steps", "1", "--input-size", "64", "--batch", "2", "--validate-every", "0")
PLAN = ("plan", "in/dem.npz", "--start", "2,2", "--goal", "20,28")


def generate(rng: random.Random, samples: Path, heavy: bool = True) -> Command:
    """A command that reads one damaged file."""
    kinds = {_dem: 6.0, _cost_map: 2.0, _recording: 2.0, _stdin: 2.0, _profile: 1.0, _model_notes: 0.7}
    if heavy:
        kinds |= {_report: 0.6, _data_set: 0.8, _checkpoint: 0.3}
    make = rng.choices(list(kinds), list(kinds.values()))[0]
    return disturbed(rng, make(rng, samples))


def _reading(words: tuple[str, ...], name: str, content: bytes, **more: object) -> Command:
    """The command with the file in the place of ``{f}``."""
    return Command(tuple(word.format(f=name) for word in words), {name: content}, needs=("drive.jsonl",), **more)  # type: ignore[arg-type]


def _dem(rng: random.Random, samples: Path) -> Command:
    name = rng.choice(DEMS)
    kind = rng.random()
    if kind < 0.5:
        others = tuple((samples / other).read_bytes()[:5000] for other in DEMS)
        content = mutated(rng, (samples / name).read_bytes(), others)
    elif kind < 0.6:
        content = (samples / rng.choice((*DEMS, "cost.npz", "tiny.onnx", "drive.jsonl", "bomb.npz"))).read_bytes()
    elif kind < 0.8:
        name, content = "dem.npz" if rng.random() < 0.7 else "dem.npy", b""
        content = _odd_archive(rng) if name.endswith("z") else _odd_array(rng)
    else:
        name, content = _odd_raster(rng)
        content = content or (samples / name).read_bytes()
    words = rng.choice(_OF_DEM if rng.random() < 0.95 else _OF_DEM_SELDOM)
    known = {parameter.name for parameter in command_of(words[0]).params}
    if rng.random() < 0.5 and "cell_size" in known:
        words += ("--cell-size", "2")
    if name.endswith("png") and "vertical_scale" in known:
        words += ("--vertical-scale", "0.01")
    return _reading(words, f"in/{name}", content)


def _cost_map(rng: random.Random, samples: Path) -> Command:
    kind = rng.random()
    if kind < 0.5:
        content = mutated(rng, (samples / "cost.npz").read_bytes())
    elif kind < 0.55:
        content = (samples / "bomb-cost.npz").read_bytes()
    else:
        content = _odd_archive(rng, "cost")
    return _reading(("run", "--map", "{f}", *_REPLAY), "in/cost.npz", content)


def _odd_array(rng: random.Random) -> bytes:
    """A .npy whose header is whole but odd, or says more than there is."""
    shapes = (
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
        (10**5, 10**5),
    )
    shapes += ("x", None, [24, 32], (24.0, 32), (True, 2), (2**63, 1), (65536, 8192))
    descrs = (
        "<f4",
        ">f4",
        "<f8",
        "<f2",
        "<f16",
        "|b1",
        "|i1",
        "|u1",
        "<i8",
        ">u2",
        "<c8",
        "|O",
        "|S4",
        "<U4",
        "<M8[s]",
    )
    descrs += ([("a", "<f4")], [("a", "<f4"), ("b", "<f4", (2,))], "junk", None, 5, "|V0", "<m8")
    known = heights(rng.randrange(100)).astype("<f4")
    data = rng.choice((known.tobytes(), known.tobytes()[: rng.randrange(3000)], b"", known.tobytes() * 3))
    if rng.random() < 0.3:
        values = np.float32(rng.choice((0.0, np.nan, np.inf, -np.inf, 1e-45, 3e38, -3e38, 1e9, 9.9e8)))
        data = np.where(np.random.default_rng(rng.getrandbits(32)).random((ROWS, COLS)) < 0.5, known, values)
        return npy("<f4", (ROWS, COLS), data.astype("<f4").tobytes())
    if rng.random() < 0.1:
        header = rng.choice((b"(" * 9000, b"{" * 300, b"{'descr': " + b"-" * 9000 + b"1}", b"\xff" * 50, b"[]", b"1"))
        return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(header)) + header
    fortran = rng.choice((False, True, None, 1))
    shape = (ROWS, COLS) if rng.random() < 0.4 else rng.choice(shapes)
    return npy(rng.choice(descrs), shape, data, fortran)


def _odd_archive(rng: random.Random, only: str = "") -> bytes:
    """An .npz with the right names and odd values, or odd names."""
    grids = (only,) if only else ("elevation_m", "elevation", "dem", "z", "elevation_m", "cost")
    arrays = {f"{rng.choice(grids)}.npy": _odd_array(rng)}
    if rng.random() < 0.6:
        good = np.clip(np.abs(heights(rng.randrange(9))), 0.0, 0.9) if only else heights(rng.randrange(9))
        arrays = {f"{grids[0]}.npy": npy("<f4", (ROWS, COLS), good.astype("<f4").tobytes())}
    for name in ("cell_size_m", "cell_m", "cell_width_m"):
        if rng.random() < 0.6:
            value = rng.choice((2.0, 2.0, 0.0, -1.0, float("nan"), float("inf"), 1e-320, 1e300, -0.0, 1e-9, 5e-324))
            kinds = (
                npy("<f8", (), struct.pack("<d", value)),
                npy("<f8", (1,), struct.pack("<d", value)),
                _odd_array(rng),
            )
            arrays[f"{name}.npy"] = rng.choices(kinds, (4, 1, 1))[0]
    if rng.random() < 0.1:
        arrays[rng.choice(("cell_size_m.npy", "x.txt", "../x.npy", "cell_size_m", "cost.npy"))] = rng.randbytes(30)
    content = npz(arrays)
    return content if rng.random() < 0.8 else mutated(rng, content)


def _odd_raster(rng: random.Random) -> tuple[str, bytes]:
    """A raster that a writer could have made, or a text that makes GDAL do something else."""
    kind = rng.randrange(6)
    if kind == 0:
        vrt = (
            '<VRTDataset rasterXSize="32" rasterYSize="24"><VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        )
        place = rng.choice(
            ("/vsicurl/http://127.0.0.1:9/x.tif", "/etc/passwd", "../in/dem.tif", "/vsistdin/", "dem.tif")
        )
        vrt += f"<SourceFilename>{place}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"
        wms = "<GDAL_WMS><Service name='TMS'><ServerUrl>http://127.0.0.1:9/${z}</ServerUrl></Service></GDAL_WMS>"
        return rng.choice(("dem.tif", "dem.vrt", "dem.asc", "dem.xyz")), rng.choice((vrt, wms)).encode()
    if kind == 1:
        words = {
            "ncols": "32",
            "nrows": "24",
            "xllcorner": "0",
            "yllcorner": "0",
            "cellsize": "2",
            "NODATA_value": "-9999",
        }
        key = rng.choice(list(words))
        words[key] = rng.choice(("0", "-1", "nan", "inf", "1e9", "1000000000", "1e400", "x", "", "31", "2147483648"))
        body = " ".join(f"{z:.2f}" for z in np.nan_to_num(heights(0, 24, 32)).ravel())
        return "dem.asc", ("\n".join(f"{k} {v}" for k, v in words.items()) + "\n" + body).encode()
    if kind == 2:
        head = struct.pack(
            ">IIBBBBB", rng.choice((32, 2**31 - 1, 65535, 0)), rng.choice((24, 2**31 - 1, 0)), 16, 0, 0, 0, 0
        )
        import zlib

        def chunk(name: bytes, data: bytes) -> bytes:
            return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

        rows = zlib.compress(bytes(24 * 65))
        return "dem.png", b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    if kind == 3:
        return "sparse.tif", b""  # the sample of that name
    import rasterio

    dtype = rng.choice(("float32", "float64", "int16", "uint8", "int32", "complex64", "float32", "int8"))
    size = rng.choice((COLS, COLS, 1, 500))
    numbers = (2.0, 2.0, 0.0, -2.0, float("nan"), float("inf"), 1e-300, 1e300)
    place = rasterio.Affine(
        rng.choice(numbers), rng.choice((0, 0, 1.0)), 0, rng.choice((0, 0, 2.0)), rng.choice(numbers), 9
    )
    kind_of = {"driver": "GTiff", "dtype": dtype, "count": rng.choice((1, 1, 1, 2, 5)), "height": ROWS, "width": size}
    kind_of |= {"transform": place, "nodata": rng.choice((None, 0, None))}
    if rng.random() < 0.5:
        kind_of["crs"] = rng.choice(("EPSG:4326", "EPSG:32633", "EPSG:3857", "EPSG:4978"))
    values = np.nan_to_num(np.resize(heights(), (kind_of["count"], ROWS, size))).astype(dtype)
    import warnings

    with warnings.catch_warnings(), rasterio.MemoryFile() as memory:
        warnings.simplefilter("ignore")
        with memory.open(**kind_of) as dataset:
            dataset.write(values)
        return "dem.tif", bytes(memory.read())


def _recording(rng: random.Random, samples: Path) -> Command:
    lines = (samples / "drive.jsonl").read_bytes().splitlines()
    for _ in range(rng.choice((1, 2, 4))):
        at = rng.randrange(len(lines))
        lines[at] = (
            rng.choice((mutated_json, mutated))(rng, lines[at]) if _is_json(lines[at]) else mutated(rng, lines[at])
        )
    content = b"\n".join(lines) + rng.choice((b"\n", b"\n", b""))
    if rng.random() < 0.1:
        content = mutated(rng, content)
    if rng.random() < 0.02:
        content += b" " * (64 << 20)
    words = (*MAP, "--input", "replay:{f}", "--fast", "--output", rng.choice(("none", "stdout")))
    words += rng.choice(
        ((), (), ("--record", "out/again.jsonl"), ("--log", "out/drive.mcap"), ("--metrics-file", "out/m"))
    )
    return _reading(words, "in/played.jsonl", content)


def _stdin(rng: random.Random, samples: Path) -> Command:
    from nnpp_edge.robot.transports.framing import framed

    lines = (samples / "messages.jsonl").read_bytes().splitlines()
    framing = rng.choice(("lines", "lines", "length"))
    parts = []
    for _ in range(rng.randrange(12)):
        line = rng.choice(lines)
        line = rng.choice((lambda r, x: x, mutated_json, mutated))(rng, line)
        parts.append(framed(line, framing))
    content = b"".join(parts)
    content = mutated(rng, content) if rng.random() < 0.3 else content
    words = (
        *MAP,
        "--framing",
        framing,
        "--rate",
        "200",
        *rng.choice(((), ("--log", "out/x.mcap"), ("--record", "out/r"))),
    )
    return Command(words, stdin=content, streams=("pipe", "pipe", "pipe"))


def _profile(rng: random.Random, samples: Path) -> Command:
    content = mutated_toml(rng, (samples / "profile.toml").read_bytes())
    of_run = ("run", "--map", "in/dem.npz", "--profile", "{f}", *_REPLAY)
    words = of_run if rng.random() < 0.8 else ("profile", "--profile", "{f}")
    return _reading(words, "in/own.toml", content, patient=words[0] == "profile")


def _model_notes(rng: random.Random, samples: Path) -> Command:
    model = (samples / "tiny.onnx").read_bytes()
    figures, card = (samples / "tiny.json").read_bytes(), (samples / "tiny.md").read_bytes()
    figures = mutated_json(rng, figures) if rng.random() < 0.8 else mutated(rng, figures)
    card = mutated(rng, card) if rng.random() < 0.3 else card
    words = rng.choice(
        (("models", "in/own.onnx"), ("models", "in/own.onnx", "--json"), (*PLAN, "--model", "in/own.onnx"))
    )
    return Command(words, {"in/own.onnx": model, "in/own.json": figures, "in/own.md": card})


def _report(rng: random.Random, samples: Path) -> Command:
    content = (samples / "report.json").read_bytes()
    content = mutated_json(rng, content) if rng.random() < 0.8 else mutated(rng, content)
    files = ["in/own.json", "in/report.json"]
    rng.shuffle(files)
    return Command(("profile", "compare", *files), {"in/own.json": content})


def _data_set(rng: random.Random, samples: Path) -> Command:
    size = rng.choice(("set32", "set"))
    shard = next((samples / size).glob("shard-*.npz")).name
    name = rng.choice(("dataset.json", "dataset.json", shard))
    content = (samples / size / name).read_bytes()
    if name == "dataset.json":
        content = mutated_json(rng, content) if rng.random() < 0.7 else mutated(rng, content)
    elif rng.random() < 0.5:
        with np.load(io.BytesIO(content)) as shards:
            arrays = dict(shards)
        key = rng.choice(list(arrays))
        changes = (
            lambda a: a[:0],
            lambda a: a[:1],
            lambda a: a.astype(np.float64) if a.dtype.kind in "iuf" else a[::-1],
            lambda a: a.ravel(),
            lambda a: a[None],
        )
        changes += (lambda a: np.full_like(a, 255) if a.dtype.kind in "iuf" else a, lambda a: np.array(5))
        arrays[key] = rng.choice(changes)(arrays[key])
        if rng.random() < 0.15:
            del arrays[key]
        made = io.BytesIO()
        np.savez(made, **arrays)
        content = made.getvalue()
    else:
        content = mutated(rng, content)
    words = rng.choice(
        (
            ("evaluate", "--dataset", f"in/{size}", "--queries", "1", "--methods", "astar", "--repeats", "1"),
            (
                "dataset",
                "-o",
                f"in/{size}",
                "--maps",
                "2",
                "--size",
                size[3:] or "64",
                "--points",
                "2",
                "--workers",
                "1",
            ),
            ("train", "in/set", "--validation", f"in/{size}", "-o", "out/run", *_ONE_STEP),
        )
    )
    return Command(words, {f"in/{size}/{name}": content}, needs=("set", size))


def _checkpoint(rng: random.Random, samples: Path) -> Command:
    content = mutated(rng, (samples / "trained" / "checkpoint.pt").read_bytes())
    train = ("train", "in/set", "--validation", "in/set", *_ONE_STEP)
    if rng.random() < 0.4:
        return Command(("export", "in/own.pt", "-o", "out/net.onnx"), {"in/own.pt": content})
    if rng.random() < 0.5:
        return Command((*train, "-o", "out/run", "--begin-with", "in/own.pt"), {"in/own.pt": content})
    history = json.dumps([{"step": junk_value(rng)}]).encode()
    files = {"in/trained/checkpoint.pt": content, "in/trained/history.json": history}
    return Command((*train, "-o", "in/trained"), files, needs=("trained",))


def _is_json(line: bytes) -> bool:
    try:
        json.loads(line)
    except (ValueError, RecursionError):
        return False
    return True
