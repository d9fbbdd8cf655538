"""A fault: a channel that reads one value whatever happens."""

from typing import Literal

from pydantic import FiniteFloat

from taxel.channels import CHANNELS
from taxel.schema import ChannelName, Schema


class Fault(Schema):
    """counts_c = value: it replaces what the other terms add up to; of two on one channel the last holds.

    Attributes:
        value: counts.
    """

    kind: Literal["fault"] = "fault"
    channel: ChannelName
    value: FiniteFloat

    @property
    def column(self) -> int:
        """Where the channel stands among `CHANNELS`."""
        return CHANNELS.index(self.channel)

    @property
    def takes(self) -> tuple[str, ...]:
        """The features that it needs as columns: none."""
        return ()
