"""The instruction sets of the processor that code is generated for."""

from functools import cache
from typing import Final

import numba
from llvmlite import binding

_X86_SETS: Final = {"avx512-vbmi": "avx512vbmi", "avx512": "avx512bw", "avx2": "avx2", "ssse3": "ssse3"}
"""The instruction sets that the evaluators distinguish, the best first, with LLVM's feature."""

_ARM: Final = ("aarch64", "arm64")
"""The start of LLVM's name of a system where every processor has NEON, even if no feature says so."""


@cache
def _features() -> frozenset[str]:
    """The features that numba generates code for: those of `NUMBA_CPU_FEATURES` or of this processor."""
    if numba.config.CPU_FEATURES is not None:
        given = str(numba.config.CPU_FEATURES).split(",")
        return frozenset(feature[1:] for feature in given if feature.startswith("+"))
    avx = bool(numba.config.ENABLE_AVX)
    try:
        found = binding.get_host_cpu_features()
    except RuntimeError:  # LLVM does not know this processor
        return frozenset()
    return frozenset(name for name, has in found.items() if has and (avx or not name.startswith("avx")))


def processor_has(feature: str) -> bool:
    """Whether code is generated for a processor with a feature, in LLVM's names."""
    return feature in _features()


def instruction_set() -> str:
    """The best instruction set that code may use; `EvaluatorInfo` lists the names."""
    if binding.get_process_triple().startswith(_ARM):
        return "neon"
    return next((name for name, feature in _X86_SETS.items() if processor_has(feature)), "generic")


def register_bytes() -> int:
    """The bytes of the widest register that a byte shuffle takes."""
    return 64 if processor_has("avx512bw") else 32 if processor_has("avx2") else 16
