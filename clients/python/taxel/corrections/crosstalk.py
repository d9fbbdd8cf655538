"""Crosstalk: a channel leaks into another."""

from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections.term import BaseTerm, Columns
from taxel.schema import ChannelName, PerChannel


class Leak(NamedTuple):
    """A share `weight` of the signal of `source` appears in `to`."""

    to: ChannelName
    source: ChannelName
    weight: FiniteFloat


class Crosstalk(BaseTerm):
    """delta_to = Σ weight (p_source - rest_source), over the leaks into a channel.

    Attributes:
        rest: resting value of each channel, counts.
    """

    kind: Literal["crosstalk"] = "crosstalk"
    leaks: Annotated[tuple[Leak, ...], Field(min_length=1)]
    rest: PerChannel

    @override
    def delta(self, p: NDArray[np.float64], columns: Columns) -> NDArray[np.float64]:
        matrix, rest = self._mixing
        return (p - rest) @ matrix

    @cached_property
    def _mixing(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Weights (source, to), and the resting values."""
        matrix = np.zeros((len(CHANNELS), len(CHANNELS)))
        for leak in self.leaks:
            matrix[CHANNELS.index(leak.source), CHANNELS.index(leak.to)] += leak.weight
        return matrix, np.array(self.rest)
