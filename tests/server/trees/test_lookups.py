"""Byte tables looked up by vectors of places, here and as code for another processor."""

import re

import numba
import numpy as np
import pytest
from llvmlite import binding, ir
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.vectors import load, store
from taxel_server.runtimes.trees.simd import lookups
from taxel_server.runtimes.trees.simd.lookups import can_look_up, lookup

SIZES = (16, 32, 48, 64, 128, 256)
LANES = 64


@pytest.mark.skipif(not can_look_up(), reason="this processor has no byte shuffle")
@pytest.mark.parametrize("size", SIZES)
def test_every_place_of_a_table_is_found(size: int) -> None:
    @numba.njit
    def look_up(table: NDArray[np.uint8], places: NDArray[np.uint8], found: NDArray[np.uint8]) -> None:
        loaded = load(places.ctypes.data, 8, LANES)
        store(found.ctypes.data, lookup(table.ctypes.data, size, loaded))

    table = np.random.default_rng(size).permutation(256).astype(np.uint8)[:size]
    for first in range(0, size, LANES):
        places = ((np.arange(LANES) + first) % size).astype(np.uint8)
        found = np.empty(LANES, np.uint8)
        look_up(table, places, found)
        np.testing.assert_array_equal(found, table[places])


@pytest.mark.parametrize("size", SIZES)
def test_on_arm_an_instruction_looks_up_64_bytes(size: int) -> None:
    # Whether it gives the right bytes needs an ARM: tests/arm emulates one.
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    module, places = ir.Module(), ir.VectorType(ir.IntType(8), 16)
    function = ir.Function(module, ir.FunctionType(places, [ir.IntType(64), places]), "look_up")
    builder = ir.IRBuilder(function.append_basic_block())
    builder.ret(lookups._permute_by_neon_tables(builder, function.args[0], size, function.args[1]))
    target = binding.Target.from_triple("aarch64-unknown-linux-gnu").create_target_machine()
    assembly = target.emit_assembly(binding.parse_assembly(str(module)))
    tables = re.findall(r"\ttbl\tv\d+\.16b, \{ (.*) \}, v\d+\.16b", assembly)
    assert [len(registers.split(",")) for registers in tables] == [min(size, 64) // 16] * -(-size // 64)
