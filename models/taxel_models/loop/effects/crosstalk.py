"""Crosstalk: a channel leaks into another."""

from collections.abc import Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections import Crosstalk as CrosstalkTerm
from taxel.corrections import Leak
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Online, Remaining
from taxel_models.loop.observations import Observations


class Crosstalk(Effect):
    """Each channel adds a part of one other channel's signal."""

    name = "crosstalk"
    follows = "measured"
    most_weight = 1.0  # No wire gives more than it carries.
    looks_at_residual = True
    equation = "delta_c = a (p_j - rest_j), j another channel"
    source = "shared wiring and the converter's multiplexer; one source a channel is assumed"
    signature = "the residual follows another channel's signal, given the channel's own"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        own = observations.predicted - observations.rest
        explained = (remaining.explained or partial(_explained, remaining))(observations.signal, own)
        np.fill_diagonal(explained, -1.0)
        yield self._with(explained.argmax(axis=0), observations)

    def _with(self, sources: NDArray[np.int64], observations: Observations) -> Candidate:
        def online(weights: Floats) -> Online:
            leaks = tuple(
                Leak(to=to, source=CHANNELS[source], weight=float(weight))
                for to, source, weight in zip(CHANNELS, sources, weights[:, 0], strict=True)
                if weight
            )
            if not leaks:
                # Single rows may show no leak where means of several do.
                return Online()
            return Online((CrosstalkTerm(leaks=leaks, rest=tuple(observations.rest.tolist())),))

        return Candidate(
            self.name,
            "one source a channel",
            Own(observations.signal[:, sources, None].astype(np.float32)),
            # Each channel's source is chosen by all the blocks that test it.
            fitting=Fitting(choices=len(CHANNELS) - 1, compared=len(CHANNELS) - 1),
            weight_names=("leak",),
            weight_units=("relative",),
            sources=tuple(CHANNELS[source] for source in sources),
            online=online,
            again=partial(self._with, sources),
        )


def _explained(remaining: Remaining, signal: Floats, own: Floats) -> Floats:
    """(21, 21) how much of channel c's residual the signal of channel j explains beside c's own."""
    weight = np.sqrt(remaining.row_weights[remaining.fit])[:, None]
    signal, own, residual = (one[remaining.fit] * weight for one in (signal, own, remaining.residual))
    return explained_beside_own(
        signal.T @ residual,
        (signal**2).sum(axis=0)[:, None],
        signal.T @ own,
        (own * residual).sum(axis=0),
        (own**2).sum(axis=0),
    )


def explained_beside_own(
    cross: Floats, energy: Floats, between: Floats, own_cross: Floats, own_energy: Floats
) -> Floats:
    """(k, 21) the fall of the squared error by each signal, once the channel's own is taken out of both.

    Args:
        cross: (k, 21) sums of products of signals and residuals.
        energy: (k, 1 or 21) of the signals' squares.
        between: (k, 21) of products of signals and channels' own signals.
        own_cross: (21,) of products of the own signals and the residuals.
        own_energy: (21,) of the own signals' squares.
    """
    own_energy, energy = np.maximum(own_energy, 1e-9), np.maximum(energy, 1e-9)
    left = cross - between * (own_cross / own_energy)
    apart = np.maximum(energy - between**2 / own_energy, 1e-9 * energy + 1e-9)
    return np.asarray(left**2 / apart)
