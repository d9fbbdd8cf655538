"""Calls a compiled function by its address: a kernel takes another kernel as an argument."""

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types

from taxel_server.runtimes.compiled.vectors import operation


@operation
def call(_context: Any, _function: Any, arguments: Any) -> Any:
    """Calls a function of the addresses and counts in a tuple; it returns nothing."""

    def generate(context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)] * len(arguments))
        values = cgutils.unpack_tuple(builder, given[1], len(arguments))
        builder.call(builder.inttoptr(given[0], kind.as_pointer()), values)
        return context.get_dummy_value()

    return types.void(types.intp, arguments), generate
