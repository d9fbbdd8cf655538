"""What a runtime tells of the code that evaluates its model."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EvaluatorInfo:
    """Which evaluator computes a call, and with which instructions of the processor.

    Attributes:
        name: of the evaluator, such as `leaf-blocks` or `onnxruntime`.
        instruction_set: `avx512-vbmi`, `avx512`, `avx2`, `ssse3`, `neon` or `generic`; empty where a
            library chooses and does not tell.
    """

    name: str
    instruction_set: str
