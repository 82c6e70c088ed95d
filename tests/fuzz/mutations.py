"""What can be wrong with bytes, numbers and words. Each function draws from `random.Random` alone."""

import json
import random
import re
from collections.abc import Callable
from typing import Any

NUMBERS = (
    *str.split("0 -0.0 1 -1 2 7 0.5 1e-45 1e-320 1e-30 1e38 3.5e38 1e308 1e999 nan -nan inf -inf NaN Infinity 1e3"),
    *str.split("2147483647 2147483648 4294967296 -9223372036854775809 1_000 0x10 ١٢ 1,5 + -- 1/0"),
    *("9" * 19, "9" * 40, "", " "),
)
WORDS = (
    *str.split(". .. - -- auto astar dstar corridor nnpp soft limit20 limit limit0 limitnan limit1e400 limit-5"),
    *str.split("edge nope none zenoh:nowhere replay: stdout:x tcp/256.1.1.1:1 A/../.. * ? ' a/b / null [] {} true"),
    *("", " ", '"', "\\", "\n", "a\nb", "\x1b[31m", "é" * 300, "x" * 256, "x" * 5000, "\udcff\udcfe", "%s%n"),
    *("{0}", "[bold]", "📍", "1,2,3"),
)
PAIRS = (*str.split("1,2 0,0 -1,-1 1 1,2,3 , 1, 1.5,2 nan,nan inf,inf 1e308,1e308"), "9" * 20 + ",0")
SIZES = (*str.split("16 2 1 0 -5 16x16 2x40 1x1 x 16x 16,16 16x16x16"), "9" * 12, "9" * 30, "")
_MOST_REPEATED = 1 << 24


def junk_bytes(rng: random.Random, most: int = 200) -> bytes:
    """Bytes without a meaning."""
    return rng.randbytes(rng.randrange(most))


def mutated(rng: random.Random, content: bytes, others: tuple[bytes, ...] = ()) -> bytes:
    """The content, damaged once to three times."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        content = rng.choice(_BYTE_MUTATIONS)(rng, content)
    if others and rng.random() < 0.05:
        other = rng.choice(others)
        content = content[: rng.randrange(len(content) + 1)] + other[rng.randrange(len(other) + 1) :]
    return content


def _two_places(rng: random.Random, content: bytes) -> tuple[int, int]:
    one, other = sorted(rng.randrange(len(content) + 1) for _ in range(2))
    return one, other


def _flip_bits(rng: random.Random, content: bytes) -> bytes:
    found = bytearray(content)
    near = len(found) if rng.random() < 0.5 else min(len(found), 256)
    for _ in range(rng.choice((1, 1, 2, 8, 64)) if near else 0):
        found[rng.randrange(near)] ^= 1 << rng.randrange(8)
    return bytes(found)


def _overwrite(rng: random.Random, content: bytes) -> bytes:
    at, count = rng.randrange(len(content) + 1), rng.choice((1, 2, 4, 8, 100))
    value = rng.choice((b"\x00", b"\xff", b"\x7f", b"\x80", b" ", b"9"))
    return content[:at] + value * min(count, len(content) - at) + content[at + count :]


def _insert(rng: random.Random, content: bytes) -> bytes:
    at = rng.randrange(len(content) + 1)
    return content[:at] + junk_bytes(rng) + content[at:]


def _cut_out(rng: random.Random, content: bytes) -> bytes:
    one, other = _two_places(rng, content)
    return content[:one] + content[other:]


def _repeat(rng: random.Random, content: bytes) -> bytes:
    one, other = _two_places(rng, content)
    times = min(rng.choice((1, 2, 50)), _MOST_REPEATED // (other - one + 1) + 1)
    return content[:other] + content[one:other] * times + content[other:]


def _other_number(rng: random.Random, content: bytes) -> bytes:
    found = list(re.finditer(rb"-?[0-9][0-9.e+-]*", content[:200_000]))
    if not found:
        return _flip_bits(rng, content)
    one = rng.choice(found)
    return content[: one.start()] + rng.choice(NUMBERS).encode() + content[one.end() :]


def _shorten(rng: random.Random, content: bytes) -> bytes:
    return content[: rng.choice((0, 1, *[rng.randrange(len(content) + 1)] * 4))]


_BYTE_MUTATIONS: tuple[Callable[[random.Random, bytes], bytes], ...] = (
    *(_flip_bits, _flip_bits, _overwrite, _insert, _cut_out, _repeat, _other_number, _other_number, _shorten),
)


def mutated_json(rng: random.Random, content: bytes) -> bytes:
    """Valid JSON whose values or keys are not what they were; the text itself is damaged now and then."""
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


def junk_value(rng: random.Random) -> Any:
    """A value of any type."""
    values: tuple[Any, ...] = (None, True, False, 0, -1, 1, 2**31, 2**64, -(2**63) - 1, 10**30, 1.5, -0.0, 1e300)
    values += (float("nan"), float("inf"), "", "x", "é\u0000", "\ud800", "1", "../../x", "x" * 400, [], {}, [[]])
    values += ([None], {"a": []}, [1, 2, 3], ["a"], {"": None}, [[1, [2]]], list(range(100)), "9" * 400)
    return rng.choice(values)


def _other_node(rng: random.Random, tree: Any) -> Any:
    """The tree with one node replaced, renamed, left out or doubled."""
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
    return junk_value(rng)


def mutated_toml(rng: random.Random, content: bytes) -> bytes:
    """TOML with a value of another type or range; damaged now and then."""
    lines = content.decode().splitlines()
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(len(lines))
        key, equals, _ = lines[at].partition(" = ")
        values = (*NUMBERS, '"x"', "true", "[]", "{}", "[[]]", '["a", "a"]', '""', "1979-05-27", "[" * 3000)
        lines[at] = f"{key} = {rng.choice(values)}" if equals else rng.choice(("", "[x]", "[loop]", "x = 1", "]"))
    found = "\n".join(lines).encode()
    return found if rng.random() < 0.85 else mutated(rng, found)
