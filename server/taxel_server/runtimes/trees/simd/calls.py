"""Calls a compiled function by its address, so that one kernel can be handed to another."""

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic


@intrinsic
def call(_context, _function, arguments):  # type: ignore[no-untyped-def]
    """Calls a function of the addresses and counts in a tuple; it returns nothing."""

    def generate(context, builder, _signature, given):  # type: ignore[no-untyped-def]
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [word] * len(arguments))
        values = cgutils.unpack_tuple(builder, given[1], len(arguments))
        builder.call(builder.inttoptr(given[0], kind.as_pointer()), values)
        return context.get_dummy_value()

    return types.void(types.intp, arguments), generate
