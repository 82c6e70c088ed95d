"""Calls of a compiled kernel by its address: numba would else compile it anew into each kernel that
calls it.
"""

from numba import typeof, types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, type_callable


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


def borrowed(value):
    """An array, or a record and all arrays in it, for a kernel that neither keeps nor returns them:
    references to them and their views are not counted.
    """
    return value


type_callable(borrowed)(lambda context: lambda value: value)


@lower_builtin(borrowed, types.Any)
def _borrowed(context, builder, signature, values):
    return _disowned(context, builder, signature.return_type, values[0])


def _disowned(context, builder, kind, value):
    if isinstance(kind, types.BaseTuple):
        fields = [
            _disowned(context, builder, each, builder.extract_value(value, n))
            for n, each in enumerate(kind.types)
        ]
        return context.make_tuple(builder, kind, fields)
    if isinstance(kind, types.Array):
        parts = cgutils.create_struct_proxy(kind)(context, builder, value=value)
        parts.meminfo = cgutils.get_null_value(parts.meminfo.type)
        parts.parent = cgutils.get_null_value(parts.parent.type)
        return parts._getvalue()
    return value


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
