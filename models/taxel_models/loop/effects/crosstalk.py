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
    between, cross = signal.T @ own, signal.T @ residual
    energy = np.maximum((own**2).sum(axis=0), 1e-9)
    every = np.maximum((signal**2).sum(axis=0), 1e-9)[:, None]
    # The own signal is taken out of the other one and of the residual.
    partial_cross = cross - between * ((own * residual).sum(axis=0) / energy)[None, :]
    partial_energy = np.maximum(every - between**2 / energy[None, :], 1e-9 * every + 1e-9)
    return np.asarray(partial_cross**2 / partial_energy)
