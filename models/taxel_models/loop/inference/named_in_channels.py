"""Named effects whose weights in a few channels are inferred together with those of a change of them.

An effect that was named first has weights of its own in every channel, and these take a part of any other
cause there. A change of some channels is therefore weighed by what is left where the named effects' weights
in these channels fit as well as they can (Frisch and Waugh 1933).
"""

from collections.abc import Callable, Collection, Sequence
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel_models.loop.basis import Floats
from taxel_models.loop.inference.evidence import Bases
from taxel_models.loop.inference.few_channels_form import ChannelForms
from taxel_models.loop.inference.products import Design, Products

_LEAST: Final = 1e-9
"""Least square of a direction of the regressors, over the largest: a smaller one is rounding."""


class NamedInChannels:
    """What changes of a few channels are weighed beside.

    Args:
        changed: (21,) channels that each named effect has.
        forms: of these effects, in the same order.
        target: (21, bins, 1) what they leave of the whitened residual.
        bases: gives what forms are weighed beside, of such a residual.
    """

    def __init__(
        self,
        changed: Sequence[NDArray[np.bool_]],
        forms: ChannelForms,
        target: Floats,
        bases: Callable[[Floats], Bases],
    ) -> None:
        self._changed, self._forms = changed, forms
        self._first = bases(target)
        # The root of the noise, by which whitened channels count.
        self._root = np.sqrt(self._first.beside.counted_noise)[:, None, None]
        self._directions = cache(self._found)
        self._bases = cache(lambda channels: bases(self._without(target, self._directions(channels))))

    def bases(self, channels: Collection[int]) -> Bases:
        """What a change of some channels is weighed beside."""
        key = tuple(sorted(channels))
        return self._bases(key) if self._directions(key).size else self._first

    def without(self, design: Design, channels: Collection[int]) -> Design:
        """A design without what other weights of the named effects in some channels explain of it."""
        directions = self._directions(tuple(sorted(channels)))
        return Design(self._without(design.values, directions), design.fold) if directions.size else design

    def products(self, design: Design, channels: Collection[int]) -> Products:
        """Of what is left in some channels, and of the regressors of a change of them."""
        return Products.of(self.bases(channels).beside, self.without(design, channels))

    def _without(self, values: Floats, directions: Floats) -> Floats:
        values = values / self._root
        inside = np.tensordot(directions, values, axes=((0, 1), (0, 1)))
        return np.asarray((values - directions @ inside) * self._root)

    def _found(self, channels: tuple[int, ...]) -> Floats:
        """(21, bins, k) independent directions of length 1, over the noise."""
        images = [
            self._forms.design({channel: place}).values
            for place, changes in enumerate(self._changed)
            for channel in channels
            if changes[channel]
        ]
        if not images:
            return np.empty((0, 0, 0))
        # The constants of all channels are inferred anyway.
        ones = self._first.beside.design.values[..., -1:]
        values = np.concatenate(images, axis=2)
        values = values - ones * ((ones * values).sum(axis=1) / (ones**2).sum(axis=1))[:, None]
        values = values / self._root
        squares, vectors = np.linalg.eigh(np.tensordot(values, values, axes=((0, 1), (0, 1))))
        kept = squares > _LEAST * squares[-1]
        return np.asarray(values @ (vectors[:, kept] / np.sqrt(squares[kept])))
