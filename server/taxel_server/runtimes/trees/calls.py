"""Calls a compiled function by its address, so that one kernel can be handed to another."""

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic


@intrinsic
def call(_context, _function, _first, _second, _third, _fourth, _fifth):  # type: ignore[no-untyped-def]
    """Calls a function of five addresses or counts that returns nothing."""

    def generate(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        word = ir.IntType(64)
        pointer = builder.inttoptr(arguments[0], ir.FunctionType(ir.VoidType(), [word] * 5).as_pointer())
        builder.call(pointer, arguments[1:])
        return context.get_dummy_value()

    return types.void(types.intp, *[types.intp] * 5), generate
