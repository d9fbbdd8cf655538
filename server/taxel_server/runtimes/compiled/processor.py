"""What the processor can do that code is generated for."""

from functools import cache
from typing import Final

import numba
from llvmlite import binding

_X86_SETS: Final = {"avx512-vbmi": "avx512vbmi", "avx512": "avx512bw", "avx2": "avx2", "ssse3": "ssse3"}
"""Each instruction set that makes a difference here, the best first, and LLVM's name for it."""

_ARM: Final = ("aarch64", "arm64")
"""How LLVM's name of a system starts where every processor has NEON; its features may leave NEON out."""


@cache
def _features() -> frozenset[str]:
    """What numba generates code for: what `NUMBA_CPU_FEATURES` names, or else what this processor has."""
    if numba.config.CPU_FEATURES is not None:
        given = str(numba.config.CPU_FEATURES).split(",")
        return frozenset(feature[1:] for feature in given if feature.startswith("+"))
    avx = bool(numba.config.ENABLE_AVX)
    try:
        found = binding.get_host_cpu_features()
    except RuntimeError:  # LLVM does not know this processor
        return frozenset()
    return frozenset(name for name, has in found.items() if has and (avx or not name.startswith("avx")))


def processor_has(*features: str) -> bool:
    """Whether code is generated for a processor with all these features, in LLVM's names."""
    return _features().issuperset(features)


def instruction_set() -> str:
    """The best of `avx512-vbmi`, `avx512`, `avx2`, `ssse3`, `neon` and `generic` that code may use."""
    if binding.get_process_triple().startswith(_ARM):
        return "neon"
    return next((name for name, feature in _X86_SETS.items() if processor_has(feature)), "generic")


def register_bytes() -> int:
    """Bytes in the widest register whose bytes can be shuffled."""
    return 64 if processor_has("avx512bw") else 32 if processor_has("avx2") else 16
