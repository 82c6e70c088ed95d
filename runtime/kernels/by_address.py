"""Calls of a compiled kernel by its address: numba would else compile it anew into each kernel that
calls it. And records that lie in memory: to hand over one of many arrays takes 10 µs at each call.
"""

from numba import typeof, types
from numba.core import cgutils
from numba.extending import lower_builtin, type_callable

RECORD_WORDS = 128
"""Of memory for a record: an array takes seven to nine."""
_RECORDS = []
"""Where kernels are not compiled: memory holds a record's number here."""


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


def reader_like(record):
    """A function of memory that reads what `put_record` wrote there, a record of the same types."""
    kind = typeof(record)

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
