"""What the processor can do that code is generated for."""

from numba.core.registry import cpu_target


def processor_has(*features: str) -> bool:
    """Whether code is generated for a processor with all these features, in LLVM's names."""
    _, _, found = cpu_target.target_context.codegen().magic_tuple()
    return {f"+{feature}" for feature in features} <= set(found.split(","))


def register_bytes() -> int:
    """Bytes in the widest register whose bytes can be shuffled."""
    return 64 if processor_has("avx512bw") else 32 if processor_has("avx2") else 16
