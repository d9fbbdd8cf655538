"""Counts the floating-point operations that a torch network makes in eager mode."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import torch
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode
from typing_extensions import override

from taxel.errors import ArtifactError
from taxel_bench.operations.rule import ELEMENTWISE, LAYER_NORMALISATION, SOFTMAX, product

_MOVES: Final = frozenset(
    {
        *("_unsafe_view", "alias", "cat", "clone", "detach", "expand", "permute", "select", "slice"),
        *("squeeze", "t", "transpose", "unbind", "unsqueeze", "view", "zeros_like", "zero_", "split"),
    }
)

_PER_VALUE: Final = {
    **dict.fromkeys(("add", "sub", "mul", "div"), ELEMENTWISE),
    **dict.fromkeys(("relu", "leaky_relu", "elu", "sigmoid", "tanh", "hardtanh", "gelu"), ELEMENTWISE),
    "_softmax": SOFTMAX,
    "native_layer_norm": LAYER_NORMALISATION,
}

_PRODUCTS: Final[dict[str, Callable[[Sequence[Any]], int]]] = {
    "mm": lambda arguments: product(arguments[0].shape[-1]),
    "bmm": lambda arguments: product(arguments[0].shape[-1]),
    "addmm": lambda arguments: product(arguments[1].shape[-1], bias=True),
}
"""Operations a value that a product gives, from its arguments."""


class _Counting(TorchDispatchMode):  # type: ignore[no-untyped-call]
    operations: int = 0

    @override
    def __torch_dispatch__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        result = func(*args, **(kwargs or {}))
        name = func.overloadpacket.__name__
        if name not in _MOVES:
            values = (result if isinstance(result, Tensor) else result[0]).numel()
            self.operations += values * _each(name, args)
        return result


def _each(name: str, arguments: Sequence[Any]) -> int:
    """Operations for each value that an operator gives."""
    if name in _PRODUCTS:
        return _PRODUCTS[name](arguments)
    if name not in _PER_VALUE:
        raise ArtifactError(f"no rule counts the operations of torch's {name}")
    return _PER_VALUE[name]


def count_network_operations(network: nn.Module, columns: int) -> int:
    """Floating-point operations of a network, one window, by `taxel_bench.operations.rule`.

    Args:
        columns: that the network takes.

    Raises:
        ArtifactError: the rule does not cover one of its operators.
    """
    window = torch.zeros(1, columns)
    counting = _Counting()  # type: ignore[no-untyped-call]
    with torch.no_grad(), counting:
        network(window)
    return counting.operations
