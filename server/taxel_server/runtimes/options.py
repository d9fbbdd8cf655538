"""Options of the evaluation."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class RuntimeOptions:
    """Options of the evaluation.

    Attributes:
        threads: the most threads of one evaluation.
        providers: ONNX Runtime's execution providers, best first; not used for trees.
        network_program: whether our compiled program may evaluate few windows of a network; if not, ONNX
            Runtime evaluates all of them.
    """

    threads: int = 1
    providers: tuple[str, ...] = ("CPUExecutionProvider",)
    network_program: bool = True


DEFAULTS: Final = RuntimeOptions()
