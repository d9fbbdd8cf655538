"""Limits of counts: what a tared channel reads in free air, whatever an effect takes from it."""

from typing import Literal, Self

from pydantic import FiniteFloat, model_validator

from taxel.channels import CHANNELS
from taxel.schema import ChannelName, Schema


class CountLimits(Schema):
    """counts_c = min(max(counts_c, low), high): it keeps what the terms add up to within limits.

    Attributes:
        channels: that have these limits.
        low: counts.
        high: counts.
    """

    kind: Literal["count_limits"] = "count_limits"
    channels: tuple[ChannelName, ...]
    low: FiniteFloat
    high: FiniteFloat

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low {self.low:g}, high {self.high:g}: expected low below high")
        return self

    @property
    def columns(self) -> list[int]:
        """Where the channels stand among `CHANNELS`."""
        return [CHANNELS.index(channel) for channel in self.channels]

    @property
    def takes(self) -> tuple[str, ...]:
        """The features that it needs as columns: none."""
        return ()
