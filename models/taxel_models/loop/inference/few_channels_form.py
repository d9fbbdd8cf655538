"""Forms that change few channels, as all whitened channels together show them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Candidate, Fitting
from taxel_models.loop.inference.forms import WhitenedForm
from taxel_models.loop.inference.products import Design
from taxel_models.loop.inference.whitening import Whitening

TOGETHER: Final = Fitting(pooled=True)
"""A regressor of one channel shows in all whitened channels, with one weight."""


@dataclass(frozen=True)
class FewChannelsForm(WhitenedForm):
    """A form that changes some channels, as regressors of all whitened channels together.

    Attributes:
        places: of each regressor, its channel and its column.
        sizes: of each regressor, what makes a weight of 1 a change as large as the noise of a bin.
    """

    places: tuple[tuple[int, int], ...]
    sizes: Floats

    @property
    @override
    def freedom(self) -> int:
        return len(self.places)

    @property
    def channels(self) -> list[int]:
        """That it changes."""
        return sorted({channel for channel, _ in self.places})

    @property
    def included(self) -> Floats:
        """(21,) 1 for a channel that it changes."""
        return np.isin(np.arange(len(CHANNELS)), self.channels).astype(np.float64)

    @override
    def weights(self, scaled: Floats) -> Floats:
        found = np.zeros((len(CHANNELS), self.size))
        for (channel, column), value, size in zip(self.places, scaled[0], self.sizes, strict=True):
            found[channel, column] = value / size
        return found


class ChannelForms:
    """Forms of an effect, each of any channels by themselves.

    Attributes:
        candidates: the forms, with regressors for every channel.

    Args:
        root: (21, 21) what whitens the channels.
        whitening: of the whitened channels' bins.
    """

    def __init__(self, candidates: Sequence[Candidate], root: Floats, whitening: Whitening) -> None:
        self.candidates, self._root, self._whitening = candidates, root, whitening
        self._means = [whitening.bins.of_basis(candidate.basis) for candidate in candidates]
        self._images: dict[tuple[int, int], tuple[Floats, Floats]] = {}

    @property
    def options(self) -> list[tuple[int, int]]:
        """The electrodes, each with the places of its forms whose regressors move it."""
        electrodes = range(len(CHANNELS))[ELECTRODE_COLUMNS]
        places = range(len(self.candidates))
        return [(one, place) for one in electrodes for place in places if self._image(place, one)[1].all()]

    def beside(self, chosen: dict[int, int], places: Sequence[int]) -> list[int]:
        """The places whose forms one candidate can hold together with the chosen ones.

        What a form with a single regressor has stands first in all others.
        """
        sizes = [candidate.basis.size for candidate in self.candidates]
        larger = {place for place in chosen.values() if sizes[place] > 1}
        return [place for place in places if not larger or place in larger or sizes[place] == 1]

    def _image(self, place: int, channel: int) -> tuple[Floats, Floats]:
        """A channel's regressors as all whitened channels show them (21, bins, k), and their sizes (k,)."""
        if (place, channel) not in self._images:
            means = self._means[place]
            own = means[channel if len(means) > 1 else 0]
            image = self._root[:, channel, None, None] * own[None]
            relative = image / self._whitening.scale[:, None, None]
            size = np.sqrt((relative**2).mean(axis=1).sum(axis=0))
            size = np.where(size > 1e-9, size, 0.0)
            safe = np.where(size > 0, size, np.inf)
            self._images[place, channel] = self._whitening(image / safe), size
        return self._images[place, channel]

    def design(self, chosen: dict[int, int]) -> Design:
        """Some channels together, each with the form of a place."""
        images = [self._image(place, channel)[0] for channel, place in chosen.items()]
        return Design(np.concatenate(images, axis=2), self._whitening.bins.fold)

    def form(self, chosen: dict[int, int]) -> FewChannelsForm:
        """The same as a form; the largest of the chosen ones holds them all."""
        sizes = {channel: self._image(place, channel)[1] for channel, place in chosen.items()}
        places = [(channel, column) for channel, own in sizes.items() for column in range(len(own))]
        candidate = self.candidates[
            max(chosen.values(), key=lambda place: self.candidates[place].basis.size)
        ]
        names = ", ".join(CHANNELS[channel] for channel in sorted(chosen))
        included = np.isin(np.arange(len(CHANNELS)), list(chosen))
        # Several join before they are tested, each chosen among all electrodes.
        compared = len(CHANNELS[ELECTRODE_COLUMNS]) if len(chosen) > 1 else 1
        fitting = replace(candidate.fitting, allowed=included, few_channels=True, compared=compared)
        kept = replace(
            candidate,
            form=f"{candidate.form}: only {names}",
            fitting=fitting,
            # Its regressors hold what was measured, which other predictions do not change.
            again=None,
        )
        unit = np.ones((len(CHANNELS), candidate.basis.size))
        return FewChannelsForm(
            kept, self.design(chosen), unit, tuple(places), np.concatenate(list(sizes.values()))
        )
