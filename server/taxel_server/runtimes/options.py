"""Options of the evaluation."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class RuntimeOptions:
    """Options of the evaluation.

    Attributes:
        threads: the most threads of one evaluation.
        providers: ONNX Runtime's execution providers, best first; not used for trees.
    """

    threads: int = 1
    providers: tuple[str, ...] = ("CPUExecutionProvider",)


DEFAULTS: Final = RuntimeOptions()
