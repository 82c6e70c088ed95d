"""The one way in which this project compiles a kernel.

numba writes its cache beside the source, and where that folder is read-only it raises at import. So
`places` chooses folders, and `cache` reads and writes the files.
"""

import functools
from types import FunctionType

import numba
from numba.core import cgutils, types
from numba.core.imputils import impl_ret_borrowed
from numba.core.types import unliteral
from numba.extending import lower_builtin, type_callable

from nnpp_edge.runtime.compiled import places
from nnpp_edge.runtime.compiled.cache import KernelCache, NumbaObject, interrupts_wait


def kernel(function: FunctionType) -> NumbaObject:
    """Compile `function` without the GIL, cached in our folders; `function.py_func` is the plain
    Python.

    A parameter that is annotated with a record, ``grid: GridRecord``, is given as a plain tuple: to
    hand over a NamedTuple takes 5 µs. It gets its name within, which takes no time. No kernel keeps
    or returns an array that it is given: references to them are not counted.

    Work is shared between cores by threads that call kernels, not by numba's own parallel loops:
    those may not be entered from two threads at once, nor after a fork. A division by zero gives
    what the processor gives: to look for it would keep the compiler from computing several cells at
    once.
    """
    compiled = helper(_of_plain_tuples(function))
    if hasattr(compiled, "overloads") and (places.OWN or places.READ):  # not NUMBA_DISABLE_JIT
        compiled._cache = KernelCache(function, places.OWN, places.READ)
    return compiled


def _of_plain_tuples(function: FunctionType) -> FunctionType:
    """`function`, which takes plain tuples in place of records; to the compiler both are one."""
    kinds = function.__annotations__
    code = function.__code__
    names = code.co_varnames[: code.co_argcount]
    inline: NumbaObject = numba.njit(inline="always")
    space = {"function": inline(function), "borrowed": borrowed}
    arguments = ", ".join(_named(kinds.get(name), name, space) for name in names)
    exec(f"def given({', '.join(names)}): return function({arguments})", space)
    named: FunctionType = space["given"]
    functools.update_wrapper(named, function)
    return named


def _named(annotation: NumbaObject, given: str, space: dict[str, NumbaObject]) -> str:
    """The code that makes a record, or what else is annotated, of what is given."""
    (kind,) = getattr(annotation, "__metadata__", (annotation,))
    if not hasattr(kind, "_fields"):
        return f"borrowed({given})"
    space[kind.__name__] = kind
    annotations = enumerate(kind.__annotations__.values())
    fields = (_named(field, f"{given}[{n}]", space) for n, field in annotations)
    return f"{kind.__name__}({', '.join(fields)})"


def borrowed(value: NumbaObject) -> NumbaObject:
    """What is given: an array without an owner, to which no references are counted."""
    return value


type_callable(borrowed)(lambda context: lambda value: value)


@lower_builtin(borrowed, types.Any)  # type: ignore[untyped-decorator]
def _borrowed(*given: NumbaObject) -> NumbaObject:
    context, builder, signature, values = given
    kind = signature.return_type
    if not isinstance(kind, types.Array):
        return impl_ret_borrowed(context, builder, kind, values[0])
    array = cgutils.create_struct_proxy(kind)(context, builder, value=values[0])
    array.meminfo = cgutils.get_null_value(array.meminfo.type)
    array.parent = cgutils.get_null_value(array.parent.type)
    return array._getvalue()


def inlined(function: FunctionType) -> NumbaObject:
    """As `helper`, for a step of a kernel's loop: its code is put in the place of each call."""
    return helper(function, forceinline=True)


def helper(function: FunctionType, **options: object) -> NumbaObject:
    """As `kernel`, for one that only kernels call: their files hold its code, and none of its own
    keeps it.
    """
    compile_it: NumbaObject = numba.njit
    compiled = compile_it(nogil=True, error_model="numpy", no_cfunc_wrapper=True, **options)(
        function
    )
    if compiled is not function:
        template = compiled.get_call_template

        def of_types(args: tuple[NumbaObject, ...], named: dict[str, NumbaObject]) -> NumbaObject:
            """Without literals: numba would compile a version for every constant in a call."""
            return template(
                tuple(map(unliteral, args)), {name: unliteral(kind) for name, kind in named.items()}
            )

        compiled.get_call_template = of_types
        load_or_compile = compiled.compile

        def whole(types: NumbaObject) -> NumbaObject:
            """An interrupt waits while it is loaded."""
            with interrupts_wait():
                return load_or_compile(types)

        compiled.compile = whole
    return compiled
