"""Rules on the source that no other tool checks. Which way imports point is import-linter's (pyproject.toml)."""

import ast
import functools
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCES = sorted(
    path for top in ("nnpp_edge", "runtime", "export", "calibrate") for path in (ROOT / top).rglob("*.py")
)
TESTS = sorted((ROOT / "tests").rglob("*.py"))
KERNELS = "runtime/kernels/"
KERNEL_IMPORTS = re.compile(
    r"(numpy|numba|llvmlite|time|math|enum|operator|typing|nnpp_edge\.runtime\.(tuning|compiled|kernels|errors))(\.|$)"
)
MOST_SOURCE_LINES, MOST_TEST_LINES = 34_450, 21_445
"""Examples and the site's scripts included (docs/decisions/code.md). Only ever to be lowered."""
MOST_PARAMETERS = 10
MORE_PARAMETERS: dict[str, float] = {}
"""Kernels with more parameters: the microseconds that a call would have cost with them bundled."""
PUBLIC_WITH_UNDERSCORE = {"_replace", "_asdict", "_fields", "_make", "_exit", "_repr_html_"}
"""Of NamedTuples, os._exit, and what notebooks call."""


def name_of(path):
    return path.relative_to(ROOT).as_posix()


@functools.cache
def tree_of(path):
    return ast.parse(path.read_text(), str(path))


def kernels(path):
    """The functions of a file that are decorated with `kernel`."""
    if "kernel" not in path.read_text():
        return
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.FunctionDef):
            decorators = (d.func if isinstance(d, ast.Call) else d for d in node.decorator_list)
            if any(ast.unparse(decorator).rpartition(".")[2] == "kernel" for decorator in decorators):
                yield node


def private(name):
    return name.startswith("_") and not name.endswith("__") and name not in PUBLIC_WITH_UNDERSCORE


def private_chains(path):
    """Places where a test reaches into an object that is not its own: `a._b`, but not `self._b`."""
    if not re.search(r"(?<!\bself)(?<!\bcls)\._[a-z]", path.read_text()):
        return
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Attribute) and private(node.attr):
            owner = node.value
            if not (isinstance(owner, ast.Name) and owner.id in ("self", "cls")):
                yield f"{name_of(path)}:{node.lineno}: {ast.unparse(node)}"


def test_the_source_does_not_creep_up():
    beside = [*ROOT.glob("examples/*.py"), *ROOT.glob("docs/_site/*.py")]
    for paths, most in ((SOURCES + beside, MOST_SOURCE_LINES), (TESTS, MOST_TEST_LINES)):
        assert sum(len(path.read_text().splitlines()) for path in paths) < most


def test_docstrings_begin_with_a_noun_where_one_serves():
    begins = re.compile(r'^ *"""(What|The same|As for)\b', re.MULTILINE)
    assert [name_of(path) for path in SOURCES if begins.search(path.read_text())] == []


def test_the_formatter_is_seldom_overruled():
    skipped = [
        name_of(path) for path in SOURCES + TESTS for line in path.read_text().splitlines() if "# fmt: skip" in line
    ]
    assert len(skipped) <= 30


def test_few_lines_say_any():
    nodes = ((path, node) for path in SOURCES for node in ast.walk(tree_of(path)))
    named = ((path, node) for path, node in nodes if "Any" in (getattr(node, "id", ""), getattr(node, "name", "")))
    assert len({(path, node.lineno) for path, node in named}) <= 30


def test_every_kernel_stands_among_the_kernels():
    outside = [f"{name_of(p)}: {k.name}" for p in SOURCES if not name_of(p).startswith(KERNELS) for k in kernels(p)]
    assert outside == []


def test_kernels_import_numbers_and_nothing_else():
    imported = set()
    for path in (each for each in SOURCES if name_of(each).startswith(KERNELS)):
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Import):
                imported |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, "imports are written out"
                imported.add(node.module or "")
    assert [name for name in sorted(imported) if not KERNEL_IMPORTS.match(name)] == []


def test_kernels_take_few_parameters():
    many = {}
    for path in SOURCES:
        for node in kernels(path):
            given = node.args
            count = len(given.posonlyargs + given.args + given.kwonlyargs)
            if count > MOST_PARAMETERS:
                many[node.name] = count
    assert set(many) == set(MORE_PARAMETERS)


def test_tests_use_what_is_public():
    found = [chain for path in TESTS for chain in private_chains(path)]
    assert found == []
