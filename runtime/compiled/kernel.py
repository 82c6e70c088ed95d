"""The one way in which this project compiles a kernel.

numba writes its cache beside the source, and where that folder is read-only it raises at import. So
`places` chooses folders, and `cache` reads and writes the files.
"""

from types import FunctionType

import numba
from numba.core.types import unliteral

from nnpp_edge.runtime.compiled import places
from nnpp_edge.runtime.compiled.cache import KernelCache, NumbaObject, interrupts_wait


def kernel(function: FunctionType) -> NumbaObject:
    """Compile `function` without the GIL, cached in our folders; `function.py_func` is the plain
    Python.

    Work is shared between cores by threads that call kernels, not by numba's own parallel loops:
    those may not be entered from two threads at once, nor after a fork. A division by zero gives
    what the processor gives: to look for it would keep the compiler from computing several cells at
    once.
    """
    compiled = helper(function)
    if (places.OWN or places.READ) and compiled is not function:  # as it is under NUMBA_DISABLE_JIT
        compiled._cache = KernelCache(function, places.OWN, places.READ)
    return compiled


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
