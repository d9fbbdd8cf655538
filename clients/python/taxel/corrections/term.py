"""What a correction's term is: something that is added to a base model's prediction."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from taxel.schema import Schema

Columns = Mapping[str, NDArray[np.float64]]
"""Features of n windows by name, each (n,)."""


class BaseTerm(Schema, ABC):
    """A term of a corrected model: counts = p + Σ terms(p, columns), then limits and faults.

    Every term is computed from the base model's own prediction p, so that their order does not
    matter. Features are called as the base model knows them, whatever the window's shift is, and
    are those of the window as it was given, before any frame is turned.
    """

    @property
    def takes(self) -> tuple[str, ...]:
        """The features that it needs as columns."""
        return ()

    @abstractmethod
    def delta(self, p: NDArray[np.float64], columns: Columns) -> NDArray[np.float64]:
        """What it adds.

        Args:
            p: (n, 21), the base model's prediction, counts.
            columns: at least those that it `takes`.

        Returns:
            (n, 21), counts.
        """
