"""Rules on the source that no other tool checks. Which way imports point is import-linter's
(pyproject.toml).
"""

import ast
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = sorted(
    path
    for top in ("nnpp_edge", "runtime", "export", "calibrate")
    for path in (ROOT / top).rglob("*.py")
)
TESTS = sorted((ROOT / "tests").rglob("*.py"))
KERNELS = "runtime/kernels/"
KERNEL_IMPORTS = re.compile(
    r"(numpy|numba|llvmlite|time|math|enum|operator|typing|nnpp_edge\.runtime\.(tuning|compiled|kernels|errors))(\.|$)"
)
MOST_SOURCE_NODES = 169_431
MOST_TEST_NODES = 132_163
"""Syntax nodes (docs/decisions/code.md). Only ever to be lowered."""
MOST_LOADED = 50
"""Modules that are loaded with `Planner`, of the runtime, or to make a model; only ever to be
lowered.
"""
JUDGING = re.compile(r"(runtime\.planners|profiling|training)(\.|$)")
SELDOM_USED = re.compile(
    r"runtime\.(network|region|robots\.(body|slope)|map\.(coarse|disc|heights)|search\.dstar_lite"
    r"|planners\.(arc_corridor|by_blocks|mending|refine|tour))(\.|$)"
)
"""What only some planners use."""
KIND = re.compile(r"\.(is|by)_(a_)?(point|disc|foot|body|slope)\b")
"""Asks which kind a robot is, in place of what is needed of it."""
MOST_PARAMETERS = 10
MORE_PARAMETERS: dict[str, float] = {}
"""Kernels with more parameters: the microseconds that a call would have cost with them bundled."""
PUBLIC_WITH_UNDERSCORE = {"_replace", "_asdict", "_fields", "_make", "_exit"}
"""Of NamedTuples, and os._exit."""


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
            if any(
                ast.unparse(decorator).rpartition(".")[2] == "kernel" for decorator in decorators
            ):
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


def nodes(path):
    """Number of syntax nodes that a reader must think through: docstrings and operators' names apart."""
    tree = tree_of(path)
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = set()
    for node in ast.walk(tree):
        if isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None:
            docstrings.update(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    kinds = (ast.operator, ast.unaryop, ast.boolop, ast.cmpop, ast.expr_context)
    places = [
        node.lineno
        for node in ast.walk(tree)
        if hasattr(node, "lineno") and not isinstance(node, kinds)
    ]
    return sum(line not in docstrings for line in places)


def packed(path):
    """Assignments in a file, and the lines of those that put a tuple into a tuple."""
    found = [
        node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Assign | ast.AnnAssign)
    ]
    pairs = [
        node.lineno
        for node in found
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Tuple)
        and isinstance(node.value, ast.Tuple)
    ]
    return len(found), pairs


def test_the_source_does_not_creep_up():
    assert sum(map(nodes, SOURCES)) <= MOST_SOURCE_NODES
    assert sum(map(nodes, TESTS)) <= MOST_TEST_NODES


def test_one_statement_assigns_one_thing():
    for paths in (SOURCES, TESTS):
        counts, pairs = zip(*map(packed, paths), strict=True)
        assert sum(map(len, pairs)) <= 0.02 * sum(counts)


def test_the_formatter_is_seldom_overruled():
    skipped = [
        name_of(path)
        for path in SOURCES + TESTS
        for line in path.read_text().splitlines()
        if "# fmt: skip" in line
    ]
    assert len(skipped) <= 30


def test_few_lines_say_any():
    nodes = ((path, node) for path in SOURCES for node in ast.walk(tree_of(path)))
    named = (
        (path, node)
        for path, node in nodes
        if "Any" in (getattr(node, "id", ""), getattr(node, "name", ""))
    )
    assert len({(path, node.lineno) for path, node in named}) <= 30


def test_every_kernel_stands_among_the_kernels():
    outside = [
        f"{name_of(p)}: {k.name}"
        for p in SOURCES
        if not name_of(p).startswith(KERNELS)
        for k in kernels(p)
    ]
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


def loaded_with(statement):
    """The modules of ours that are loaded with an import."""
    command = [sys.executable, "-c", f"{statement}; import sys; print(*sys.modules)"]
    found = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return [name.removeprefix("nnpp_edge.") for name in found if "nnpp_edge." in name]


def test_a_planner_loads_few_modules_and_no_room_that_only_some_use():
    loaded = loaded_with("from nnpp_edge.runtime import Planner")
    assert sum("runtime." in name for name in loaded) <= MOST_LOADED
    assert [name for name in loaded if SELDOM_USED.match(name)] == []


def test_what_makes_models_loads_neither_planners_nor_training():
    pytest.importorskip("torch")
    loaded = loaded_with("import nnpp_edge.calibrate.quantize")
    assert len(loaded) <= MOST_LOADED
    assert [name for name in loaded if JUDGING.match(name)] == []


def test_nobody_asks_which_kind_a_robot_is():
    others = (path for path in SOURCES if "runtime/robots/" not in str(path))
    assert [path for path in others if KIND.search(path.read_text())] == []


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


def test_a_test_module_says_first_what_it_guards():
    silent = [name_of(path) for path in TESTS if not ast.get_docstring(tree_of(path))]
    assert silent == []
