"""Damage to bytes, and to what files of known formats hold. Each function draws from
`random.Random` alone.
"""

import contextlib
import io
import json
import random
import re
import zipfile
from typing import Any

NUMBERS = (
    *str.split(
        "0 -0.0 1 -1 2 7 0.5 1e-45 1e-320 1e-30 1e38 3.5e38 1e308 1e999 nan -nan inf -inf NaN "
        "Infinity 1e3"
    ),
    *str.split("2147483647 2147483648 4294967296 -9223372036854775809 1_000 0x10 ١٢ 1,5 + -- 1/0"),
    *("9" * 19, "9" * 40, "", " "),
)
WORDS = (
    *str.split(
        ". .. - -- auto astar dstar corridor nnpp soft limit20 limit limit0 limitnan limit1e400 "
        "limit-5"
    ),
    *str.split(
        "edge nope none zenoh:nowhere replay: stdout:x tcp/256.1.1.1:1 A/../.. * ? ' a/b / null "
        "[] {} true"
    ),
    *(
        "",
        " ",
        '"',
        "\\",
        "\n",
        "a\nb",
        "\x1b[31m",
        "é" * 300,
        "x" * 256,
        "x" * 5000,
        "\udcff\udcfe",
        "%s%n",
    ),
    *("{0}", "[bold]", "📍", "1,2,3"),
)
JUNK = r"""[
  null, true, false, 0, -1, 1, 2147483648, 18446744073709551616, -9223372036854775809,
  1000000000000000000000000000000, 1.5, -0.0, 1e300, NaN, Infinity, "", "x", "\u00e9\u0000",
  "\ud800", "1", "../../x", [], {}, [[]], [null], {"a": []}, [1, 2, 3], ["a"], {"": null},
  [[1, [2]]]
]"""
_MOST_REPEATED = 1 << 24
_MEMBERS = str.split(
    "elevation.npy dem.npy cost.npy cell_size_m.npy cell_width_m.npy cell_size_m x.txt ../x.npy"
)


def junk_bytes(rng: random.Random, most: int = 200) -> bytes:
    """Bytes without a meaning."""
    return rng.randbytes(rng.randrange(most))


def junk_value(rng: random.Random) -> Any:
    """A value of any type."""
    return rng.choice((*json.loads(JUNK), "x" * 400, list(range(100)), "9" * 400))


def mutated(rng: random.Random, content: bytes) -> bytes:
    """The content with its bytes damaged once to three times."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        one, other = sorted(rng.randrange(len(content) + 1) for _ in range(2))
        begin = content[:one]
        inside = content[one:other]
        end = content[other:]
        numbers = list(re.finditer(rb"-?[0-9][0-9.e+-]*", content[:200_000]))
        near = len(content) if rng.random() < 0.5 else min(len(content), 256)
        kinds = "flip flip flip overwrite insert cut repeat number number end"
        match rng.choice(kinds.split()):
            case "flip" if near:
                for _ in range(rng.choice((1, 1, 2, 8, 64))):
                    at = rng.randrange(near)
                    content = (
                        content[:at]
                        + bytes((content[at] ^ 1 << rng.randrange(8),))
                        + content[at + 1 :]
                    )
            case "overwrite":
                value = rng.choice((b"\x00", b"\xff", b"\x7f", b"\x80", b" ", b"9")) * rng.choice(
                    (1, 2, 4, 8, 100)
                )
                content = begin + value + content[one + len(value) :]
            case "number" if numbers:
                found = rng.choice(numbers)
                content = (
                    content[: found.start()] + rng.choice(NUMBERS).encode() + content[found.end() :]
                )
            case "repeat":
                content = (
                    begin
                    + inside * min(rng.choice((2, 3, 50)), _MOST_REPEATED // (other - one + 1) + 1)
                    + end
                )
            case "end":
                content = content[: rng.choice((0, 1, one, other))]
            case kind:
                content = (
                    begin + junk_bytes(rng) + inside + end if kind == "insert" else begin + end
                )
    return content


def damaged(rng: random.Random, content: bytes) -> bytes:
    """A file that holds something else, by its format, or whose bytes are damaged."""
    of_format = {b"PK": _other_archive, b"{": _other_lines, b"\x08": _other_model}
    for begin, other in of_format.items():
        if content.startswith(begin) and rng.random() < 0.6:
            return other(rng, content)
    return mutated(rng, content)


def mutated_json(rng: random.Random, content: bytes) -> bytes:
    """Valid JSON whose values or keys are not what they were; the text itself is damaged now and
    then.
    """
    tree = json.loads(content)
    for _ in range(rng.choice((1, 1, 2, 5))):
        tree = _other_node(rng, tree)
    text = json.dumps(tree)
    if rng.random() < 0.15:
        text = text.replace("0", rng.choice(("1e999", "-1", "1" * 400, "NaN")), 1)
    if rng.random() < 0.05:
        deep = rng.choice((100, 5000, 200_000))
        text = rng.choice(("[", '{"a":')) * deep + rng.choice(("", "]" * deep))
    return text.encode() if rng.random() < 0.9 else mutated(rng, text.encode())


def _other_node(rng: random.Random, tree: Any) -> Any:
    """The tree with one node replaced, renamed, left out or doubled; a text that is JSON is a tree
    of its own.
    """
    kind = rng.random()
    if isinstance(tree, dict) and tree and rng.random() < 0.85:
        key = rng.choice(list(tree))
        if kind < 0.1:
            return {k: v for k, v in tree.items() if k != key}
        if kind < 0.15:
            return {rng.choice(WORDS) if k == key else k: v for k, v in tree.items()}
        return {k: _other_node(rng, v) if k == key else v for k, v in tree.items()}
    if isinstance(tree, list) and tree and rng.random() < 0.7:
        at = rng.randrange(len(tree))
        here = [] if kind < 0.2 else [tree[at]] * 2 if kind < 0.4 else [_other_node(rng, tree[at])]
        return [*tree[:at], *here, *tree[at + 1 :]]
    if isinstance(tree, str) and tree.startswith("{") and kind < 0.9:
        with contextlib.suppress(ValueError):
            return mutated_json(rng, tree.encode()).decode("utf-8", "replace")
    return (
        rng.choice((*NUMBERS, *WORDS)) if isinstance(tree, str) and kind < 0.6 else junk_value(rng)
    )


def _other_lines(rng: random.Random, content: bytes) -> bytes:
    """JSON, or lines of it of which one is changed, and some doubled or left out."""
    with contextlib.suppress(ValueError):
        return mutated_json(rng, content)
    lines = content.splitlines()
    if rng.random() < 0.4:
        lines = [lines[0], *rng.choices(lines, k=len(lines))]
    at = rng.randrange(len(lines))
    lines[at] = rng.choice((mutated_json, mutated))(rng, lines[at])
    return b"\n".join(lines) + rng.choice((b"\n", b"\n", b"", b" " * (1 << 20)))


def _other_archive(rng: random.Random, content: bytes) -> bytes:
    """One file in it damaged, of another name, or missing."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(list(files))
    kind = rng.random()
    inner = files.pop(name)
    if kind < 0.9:
        files[name if kind < 0.75 else rng.choice(_MEMBERS)] = (
            damaged(rng, inner) if kind < 0.8 else inner
        )
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return made.getvalue()


def _other_model(rng: random.Random, content: bytes) -> bytes:
    """An ONNX model with another value anywhere: a name, a shape, an operator, our metadata."""
    from google.protobuf import json_format
    from onnx import ModelProto

    tree = json_format.MessageToDict(
        ModelProto.FromString(content), preserving_proto_field_name=True
    )
    for _ in range(20):
        with contextlib.suppress(Exception):  # of values that have no place there
            return bytes(
                json_format.ParseDict(_other_node(rng, tree), ModelProto()).SerializeToString()
            )
    return mutated(rng, content)
