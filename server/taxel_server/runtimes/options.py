"""What may be chosen about evaluation."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class RuntimeOptions:
    """What may be chosen about evaluation.

    Attributes:
        threads: that one evaluation may use.
        providers: ONNX Runtime's execution providers, best first; trees have no use for them.
    """

    threads: int = 1
    providers: tuple[str, ...] = ("CPUExecutionProvider",)


DEFAULTS: Final = RuntimeOptions()
