"""Calls of a compiled kernel by its address: numba would else compile it anew into each kernel that
calls it.
"""

from numba import typeof, types
from numba.core import cgutils
from numba.extending import intrinsic


@intrinsic
def call_at(typing_context, address, arguments):
    """Call the kernel at an address, compiled for just these arguments, a tuple; what it returns is
    dropped.
    """

    def generate(context, builder, signature, values):
        convention = context.call_conv
        kinds = signature.args[1].types
        function = convention.get_function_type(types.none, kinds)
        pointer = builder.inttoptr(values[0], function.as_pointer())
        convention.call_function(
            builder, pointer, types.none, kinds, cgutils.unpack_tuple(builder, values[1])
        )
        return context.get_dummy_value()

    return types.none(address, arguments), generate


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
