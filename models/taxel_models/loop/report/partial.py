"""What an effect leaves and takes away, with all other named ones taken out, on the evaluation part."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_models.loop.attribution import Named
from taxel_models.loop.basis import Floats
from taxel_models.loop.pipeline import LoopResult

_MOST_SHOWN: Final = 4
_LEAST_TO_SHOW: Final = 0.1
"""Of the channel that is changed most: what is changed less is not drawn."""


@dataclass(frozen=True)
class Partial:
    """Partial residuals of one effect (Larsen and McCleary 1972) at the m evaluation rows.

    Attributes:
        named: the effect.
        rows: (n,) which of the observations' rows they are.
        before: (m, 21) what the other named effects leave, counts.
        after: (m, 21) what is left with this one too, counts.
        contribution: (m, 21) their difference, counts.
        channels: columns that it changes most, at most four.
    """

    named: Named
    rows: NDArray[np.bool_]
    before: Floats
    after: Floats
    contribution: Floats
    channels: tuple[int, ...]

    @classmethod
    def of(cls, result: LoopResult, named: Named) -> Self:
        """Of one of the named effects."""
        rows = result.blocks.evaluation
        after, contribution = result.attribution.residual[rows], named.contribution[rows]
        before = after + contribution
        energy = (contribution**2).mean(axis=0) / np.maximum((before**2).mean(axis=0), 1e-9)
        most = [
            int(channel)
            for channel in np.argsort(-energy)[:_MOST_SHOWN]
            if energy[channel] >= _LEAST_TO_SHOW * energy.max()
        ]
        return cls(named, rows, before, after, contribution, tuple(most))

    @property
    def kind(self) -> str:
        """The effect's name without a covariate's."""
        return self.named.name.partition(":")[0]

    @property
    def channel_names(self) -> list[str]:
        """Of the channels that it changes most."""
        return [CHANNELS[channel] for channel in self.channels]
