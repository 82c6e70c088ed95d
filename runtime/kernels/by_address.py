"""Calls of a compiled kernel by its address: numba would else compile it anew into each kernel that
calls it.
"""

from numba import typeof, types
from numba.core import cgutils
from numba.extending import lower_builtin, type_callable


def call_at(kernel, address, arguments):
    """Call a kernel that lies at an address, compiled for just these arguments, a tuple; what it
    returns is dropped.
    """
    kernel(*arguments)


type_callable(call_at)(lambda context: lambda kernel, address, arguments: types.none)


@lower_builtin(call_at, types.Any, types.Integer, types.BaseTuple)
def _call_at(context, builder, signature, values):
    convention = context.call_conv
    _, address, arguments = values
    kinds = signature.args[2].types
    function = convention.get_function_type(types.none, kinds)
    pointer = builder.inttoptr(address, function.as_pointer())
    unpacked = cgutils.unpack_tuple(builder, arguments)
    convention.call_function(builder, pointer, types.none, kinds, unpacked)
    return context.get_dummy_value()


def address_of(kernel, *arguments):
    """Where a kernel, compiled for such arguments as these, lies in memory; 0 where kernels are not
    compiled.
    """
    if not hasattr(kernel, "overloads"):
        return 0
    if not kernel.overloads:
        kernel.compile(tuple(map(typeof, arguments)))
    (compiled,) = kernel.overloads.values()
    return compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
