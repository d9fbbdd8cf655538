"""How the functions that evaluate a network are compiled."""

from collections.abc import Callable
from typing import Final, ParamSpec, TypeVar, cast

import numba

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")

_ANY_ORDER: Final = {"reassoc", "contract"}


def strict(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Compiles a function whose order of operations counts. A division by 0 raises no error."""
    return cast("Callable[_Given, _Result]", numba.njit(error_model="numpy")(function))


def any_order(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Compiles a function whose sums may have any order: LLVM then adds a register of values at once."""
    return cast("Callable[_Given, _Result]", numba.njit(error_model="numpy", fastmath=_ANY_ORDER)(function))
