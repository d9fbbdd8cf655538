"""A fault: a channel that reads one value whatever happens."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import FiniteFloat
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections.term import BaseTerm, Columns
from taxel.schema import ChannelName


class Substitute(BaseTerm):
    """counts_c = value: it comes after all other terms, and of two on one channel the last holds.

    Attributes:
        value: counts.
    """

    kind: Literal["substitute"] = "substitute"
    channel: ChannelName
    value: FiniteFloat

    @property
    def column(self) -> int:
        """Where the channel stands among `CHANNELS`."""
        return CHANNELS.index(self.channel)

    @property
    @override
    def takes(self) -> tuple[str, ...]:
        return ()

    @override
    def delta(self, p: NDArray[np.float64], columns: Columns) -> NDArray[np.float64]:
        """What it comes to where no other term acts on its channel."""
        delta = np.zeros_like(p)
        delta[:, self.column] = self.value - p[:, self.column]
        return delta
