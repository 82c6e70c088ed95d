"""Damage to bytes, and to what files of known formats hold. Each function draws from
`random.Random` alone.
"""

import contextlib
import io
import json
import re
import zipfile

NUMBERS = [
    *str.split(
        "0 -0.0 1 -1 2 7 0.5 1e-45 1e-320 1e-30 1e38 3.5e38 1e308 1e999 nan -nan inf -inf NaN "
        "Infinity 1e3 2147483647 2147483648 4294967296 -9223372036854775809 9999999999999999999 "
        "1_000 0x10 ١٢ 1,5 + -- 1/0"
    ),
    *("9" * 40, "", " "),
]
WORDS = [
    *str.split(
        ". .. - -- auto astar dstar corridor nnpp soft limit20 limit limit0 limitnan limit1e400 "
        "limit-5 edge nope none zenoh:nowhere replay: stdout:x tcp/256.1.1.1:1 A/../.. * ? ' a/b / "
        'null [] {} true " \\ \x1b[31m %s%n {0} [bold] 📍 1,2,3 \udcff\udcfe'
    ),
    *("", " ", "\n", "a\nb", "é" * 300, "x" * 256, "x" * 5000),
]
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


def junk_bytes(rng, most=200):
    """Bytes without a meaning."""
    return rng.randbytes(rng.randrange(most))


def junk_value(rng):
    """A value of any type."""
    return rng.choice((*json.loads(JUNK), "x" * 400, list(range(100)), "9" * 400))


def mutated(rng, content):
    """The content with its bytes damaged once to three times."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        near = rng.choice((len(content), min(len(content), 256)))
        at, end = sorted(rng.randrange(near + 1) for _ in range(2))
        kind = rng.choice(str.split("flip flip flip overwrite insert cut repeat number number end"))
        if kind == "number" and (found := [*re.finditer(rb"-?\d[\d.e+-]*", content[:200_000])]):
            at, end = rng.choice(found).span()
        if kind in ("flip", "overwrite"):
            end = min(end, at + rng.choice((1, 1, 2, 8, 100)))
        inside = content[at:end]
        repeated = min(rng.choice((2, 3, 50)), _MOST_REPEATED // (len(inside) + 1) + 1)
        new = {
            "flip": bytes(byte ^ 1 << rng.randrange(8) for byte in inside),
            "overwrite": rng.choice((b"\x00", b"\xff", b"\x7f", b"\x80", b" ", b"9")) * len(inside),
            "insert": junk_bytes(rng) + inside,
            "repeat": inside * repeated,
            "number": rng.choice(NUMBERS).encode(),
        }
        content = content[:at] + new.get(kind, b"") + content[end:] * (kind != "end")
    return content


def damaged(rng, content):
    """A file that holds something else, by its format, or whose bytes are damaged."""
    if rng.random() < 0.6:
        if content.startswith(b"PK"):
            return _other_archive(rng, content)
        if content.startswith(b"{"):
            return _other_lines(rng, content)
    return mutated(rng, content)


def mutated_json(rng, content):
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


def _other_node(rng, tree):
    """The tree with one node replaced, renamed, left out or doubled; a text that is JSON is a tree
    of its own.
    """
    kind = rng.random()
    if isinstance(tree, dict | list) and tree and rng.random() < 0.8:
        items = [*(tree.items() if isinstance(tree, dict) else enumerate(tree))]
        at = rng.randrange(len(items))
        key, value = items[at]
        here = [(key, value)] * 2 if kind < 0.2 else [(key, _other_node(rng, value))]
        if kind < 0.1:
            here = []
        elif kind < 0.15:
            here = [(rng.choice(WORDS), value)]
        items[at : at + 1] = here
        return dict(items) if isinstance(tree, dict) else [value for _, value in items]
    if isinstance(tree, str) and tree.startswith("{") and kind < 0.9:
        with contextlib.suppress(ValueError):
            return mutated_json(rng, tree.encode()).decode("utf-8", "replace")
    is_text = isinstance(tree, str) and kind < 0.6
    return rng.choice((*NUMBERS, *WORDS)) if is_text else junk_value(rng)


def _other_lines(rng, content):
    """JSON, or lines of it of which one is changed, and some doubled or left out."""
    with contextlib.suppress(ValueError):
        return mutated_json(rng, content)
    lines = content.splitlines()
    if rng.random() < 0.4:
        lines = [lines[0], *rng.choices(lines, k=len(lines))]
    at = rng.randrange(len(lines))
    lines[at] = rng.choice((mutated_json, mutated))(rng, lines[at])
    return b"\n".join(lines) + rng.choice((b"\n", b"\n", b"", b" " * (1 << 20)))


def _other_archive(rng, content):
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
