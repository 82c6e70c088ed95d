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
    return rng.choice((*json.loads(JUNK), *NUMBERS, *WORDS, list(range(100))))


def mutated(rng, content):
    """The content with its bytes damaged once to three times, often near the beginning."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        near = rng.choice((len(content), min(len(content), 256)))
        at = rng.randrange(near + 1)
        end = at + min(rng.randrange(near - at + 1), rng.choice((1, 1, 2, 8, 100, near)))
        numbers = [*re.finditer(rb"-?\d[\d.e+-]*", content[:200_000])]
        if numbers and rng.random() < 0.2:
            at, end = rng.choice(numbers).span()
            new = rng.choice(NUMBERS).encode()
        else:
            old = content[at:end]
            flipped = bytes(byte ^ 1 << rng.randrange(8) for byte in old)
            same = rng.choice((b"\x00", b"\xff", b"\x80", b" ", b"9")) * len(old)
            repeated = old * min(rng.choice((2, 50)), _MOST_REPEATED // (len(old) + 1) + 1)
            new = rng.choice((flipped, flipped, flipped, same, repeated, junk_bytes(rng), b""))
        content = content[:at] + new + content[end:] * (rng.random() < 0.9)
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
    """Valid JSON whose values or keys are not what they were; seldom damaged, or very deep."""
    tree = json.loads(content)
    for _ in range(rng.choice((1, 1, 2, 5))):
        tree = _other_node(rng, tree)
    text = json.dumps(tree)
    if rng.random() < 0.05:
        text = rng.choice(("[", '{"a":')) * rng.choice((100, 5000, 200_000)) + text
    return text.encode() if rng.random() < 0.9 else mutated(rng, text.encode())


def _other_node(rng, tree):
    """The tree with one node replaced, renamed, left out or doubled; a text that is JSON is a tree
    of its own.
    """
    if isinstance(tree, dict | list) and tree and rng.random() < 0.8:
        items = [*(tree.items() if isinstance(tree, dict) else enumerate(tree))]
        at = rng.randrange(len(items))
        key, value = items[at]
        changed = (key, _other_node(rng, value))
        renamed = (rng.choice(WORDS), value)
        items[at : at + 1] = rng.choice(([changed], [changed], [items[at]] * 2, [renamed], []))
        return dict(items) if isinstance(tree, dict) else [value for _, value in items]
    if isinstance(tree, str) and tree.startswith("{"):
        with contextlib.suppress(ValueError):
            return mutated_json(rng, tree.encode()).decode("utf-8", "replace")
    return junk_value(rng)


def _other_lines(rng, content):
    """JSON, or lines of it of which one is changed, and some doubled or left out."""
    with contextlib.suppress(ValueError):
        return mutated_json(rng, content)
    first, *lines = content.splitlines()
    lines = [first, *rng.choice((lines, rng.choices(lines, k=len(lines))))]
    at = rng.randrange(len(lines))
    lines[at] = rng.choice((mutated_json, mutated))(rng, lines[at])
    return b"\n".join(lines) + rng.choice((b"\n", b"", b" " * (1 << 20)))


def _other_archive(rng, content):
    """One file in it damaged, of another name, or missing."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice([*files])
    inner = files.pop(name)
    changed = {name: damaged(rng, inner)}
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for each in (
            files | rng.choice((changed, changed, {rng.choice(_MEMBERS): inner}, {}))
        ).items():
            archive.writestr(*each)
    return made.getvalue()
