"""Calls of a compiled kernel by its address: numba would else compile it anew into each kernel that
calls it. And records that lie in memory: to hand over one of many arrays takes 10 µs at each call.
"""

import numpy as np
from numba import typeof, types
from numba.core import cgutils
from numba.extending import lower_builtin, type_callable

RECORD_WORDS = 224
"""Of memory for a record: an array takes seven to eleven."""
_RECORDS = []
"""Where kernels are not compiled: memory holds a record's number here."""


def call_at(kernel, address, arguments, like):
    """Call a kernel that lies at an address, compiled for just these arguments, a tuple; what it
    returns is of the type of `like`.
    """
    return kernel(*arguments)


type_callable(call_at)(lambda context: lambda kernel, address, arguments, like: like)


@lower_builtin(call_at, types.Any, types.Integer, types.BaseTuple, types.Any)
def _call_at(context, builder, signature, values):
    convention = context.call_conv
    _, address, arguments, _ = values
    kinds = signature.args[2].types
    kind = signature.return_type
    function = convention.get_function_type(kind, kinds)
    pointer = builder.inttoptr(address, function.as_pointer())
    unpacked = cgutils.unpack_tuple(builder, arguments)
    _, found = convention.call_function(builder, pointer, kind, kinds, unpacked)
    return found


def address_of(kernel, *arguments):
    """Where a kernel, compiled for such arguments as these, lies in memory; 0 where kernels are not
    compiled.
    """
    if not hasattr(kernel, "overloads"):
        return 0
    kinds = tuple(map(typeof, arguments))
    if kinds not in kernel.overloads:
        kernel.compile(kinds)
    compiled = kernel.overloads[kinds]
    return compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)


def put_record(memory, record):
    """Write a record into memory, (RECORD_WORDS,) int64. Its arrays must outlive that."""
    memory[0] = len(_RECORDS)
    _RECORDS.append(record)


type_callable(put_record)(lambda context: lambda memory, record: types.none)


@lower_builtin(put_record, types.Array, types.BaseTuple)
def _put_record(context, builder, signature, values):
    memory, record = values
    assert context.get_abi_sizeof(record.type) <= 8 * RECORD_WORDS
    data = context.make_array(signature.args[0])(context, builder, memory).data
    builder.store(record, builder.bitcast(data, record.type.as_pointer()))
    return context.get_dummy_value()


def blank(kind, dimensions=1):
    """A record of this kind in which nothing is: no elements of arrays, and numbers that are 0; or
    what else a field is annotated with.
    """
    if hasattr(kind, "__metadata__"):
        (told,) = kind.__metadata__
        return blank(kind.__origin__, told) if isinstance(told, int) else blank(told)
    if hasattr(kind, "_fields"):
        return kind(*map(blank, kind.__annotations__.values()))
    if isinstance(kind, type):
        return kind()
    _, number = kind.__args__
    return np.empty((0,) * dimensions, *number.__args__)


def reader_of(record):
    """A function of memory that reads what `put_record` wrote there, a record of this kind."""
    kind = typeof(blank(record))

    def read(memory):
        return _RECORDS[memory[0]]

    type_callable(read)(lambda context: lambda memory: kind)

    @lower_builtin(read, types.Array)
    def _read(context, builder, signature, values):
        (memory,) = values
        data = context.make_array(signature.args[0])(context, builder, memory).data
        pointer = context.get_value_type(kind).as_pointer()
        return builder.load(builder.bitcast(data, pointer))

    return read
