"""Offsets of each contact: steady within contacts, scattered between them.

No model can predict them. They are told by their size: the part of the residual that a whole contact
shares is larger than in the model's own held-out residual.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Remaining
from taxel_models.loop.inference.evidence import HeldOut, Weighed, mean_odds
from taxel_models.loop.inference.forms import WhitenedForm, prepared
from taxel_models.loop.inference.whitening import Whitening
from taxel_models.loop.observations import FEWEST_CONTACTS, Observations, runs

CALIBRATIONS_S: Final = (0.5, 1.0)

SCATTER_UNKNOWN: Final = (
    "how far offsets of contacts scatter is not known: expected a model that was exported with "
    f"{FEWEST_CONTACTS} contacts"
)


@dataclass(frozen=True)
class Calibrated:
    """What a calibration at the start of each contact would bring.

    Attributes:
        offsets: (n, 21) mean residual of the first seconds of each row's contact, counts.
        shares: (21,) the part of that offset that stays, by least squares.
        gain: (folds, 21) fall of the squared error after those seconds, counts²; shares are fitted to the
            other folds.
        before: (folds, 21) the squared error after those seconds, counts².
    """

    offsets: Floats
    shares: Floats
    gain: Floats
    before: Floats

    @property
    def removed(self) -> float:
        """The share of the squared error that goes, mean over the channels."""
        return float((self.gain.sum(axis=0) / np.maximum(self.before.sum(axis=0), 1e-9)).mean())


def calibrated(
    observations: Observations, blocks: Blocks, left: Floats, counted: Floats, seconds: float
) -> Calibrated:
    """Take the first seconds of each contact of a residual (n, 21) as its offset.

    Args:
        blocks: rows of the evaluation part get offsets, too, but are not counted.
        counted: (n, 21) how much each row counts.
    """
    folds = int(blocks.fold.max()) + 1
    own, cross, before = np.zeros((3, folds, len(CHANNELS)))
    offsets = np.zeros_like(left)
    fold_of_row = np.where(blocks.of_row >= 0, blocks.fold[blocks.of_row], -1)
    early = max(1, round(seconds / TICK_S))
    for contact in runs(observations.contact):
        offset = left[contact][:early].mean(axis=0)
        offsets[contact] = offset
        later = np.arange(contact.start + early, contact.stop)
        for fold in np.unique(fold_of_row[later]):
            if fold >= 0:
                rows = later[fold_of_row[later] == fold]
                own[fold] += counted[rows].sum(axis=0) * offset**2
                cross[fold] += (counted[rows] * left[rows]).sum(axis=0) * offset
                before[fold] += (counted[rows] * left[rows] ** 2).sum(axis=0)
    others = own.sum(axis=0) - own, cross.sum(axis=0) - cross
    share = np.clip(others[1] / np.maximum(others[0], 1e-12), 0.0, 1.0)
    whole = np.clip(cross.sum(axis=0) / np.maximum(own.sum(axis=0), 1e-12), 0.0, 1.0)
    return Calibrated(offsets, whole, 2 * share * cross - share**2 * own, before)


class ContactOffset(Effect):
    """An offset of each contact. It has no forms of its own: a calibration gives it."""

    name = "offset:contact"
    is_predictable = False
    equation = "delta_c = b_c,contact"
    source = "one-way random effects (Searle, Casella and McCulloch 1992)"
    signature = "the residual is steady within a contact, and its mean scatters between contacts"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        return ()

    def form(self, offsets: Floats, removed: Mapping[float, float]) -> Candidate:
        """The offsets (n, 21), counts, as a form that is reported and cannot be served.

        Args:
            removed: the share of the squared error that a calibration of so many seconds takes off.
        """
        told = ", ".join(f"{seconds:g} s would remove {share:.0%}" for seconds, share in removed.items())
        return Candidate(
            self.name,
            f"of each contact; calibrating for {told} of the squared error",
            Own(offsets[:, :, None].astype(np.float32)),
            fitting=Fitting(fixed=True),
            weight_names=("share of the offset",),
            weight_units=("relative",),
            again=lambda _: self.form(offsets, removed),
        )


def log_evidence(
    white: Floats, ones: Floats, blocks: tuple[slice, ...], strengths: tuple[float, ...]
) -> Floats:
    """(strengths, 21) log odds of a random constant of each block's contacts to none.

    Args:
        white: (21, bins) the whitened residual.
        ones: (21, bins, k) whitened constants of the residual's size, one for each contact of a block.
    """
    gram = np.stack([ones[:, block].transpose(0, 2, 1) @ ones[:, block] for block in blocks])
    cross = np.stack([np.einsum("cbk,cb->ck", ones[:, block], white[:, block]) for block in blocks])
    energy = np.maximum((white**2).sum(axis=1), 1e-9)
    found = []
    for strength in strengths:
        inner = np.eye(ones.shape[2]) + strength**2 * gram
        taken = (cross * np.linalg.solve(inner, strength**2 * cross[..., None])[..., 0]).sum(axis=(0, 2))
        volume = 0.5 * np.linalg.slogdet(inner)[1].sum(axis=0)
        left = np.maximum(energy - taken, 1e-9 * energy)
        found.append(-volume - 0.5 * white.shape[1] * np.log(left / energy))
    return np.array(found)


class ContactOffsets:
    """Weighs and tests offsets of contacts on the fit part.

    Args:
        observations: the recordings; only the numbers of their contacts are used.
        blocks: the fit part and the evaluation part.
        whitening: of the fit part's bins.
        strengths: prior sizes over the channel's residual.

    Attributes:
        count: contacts of the fit part.
    """

    def __init__(
        self,
        observations: Observations,
        blocks: Blocks,
        whitening: Whitening,
        strengths: tuple[float, ...],
    ) -> None:
        self._observations, self._blocks = observations, blocks
        self._bins, self._whitening, self._strengths = whitening.bins, whitening, strengths
        self._row_weights = whitening.row_weights(len(observations))
        self.count = len(np.unique(observations.contact[blocks.fit]))

    def weighed(
        self, left: Floats, noise: Floats, usual: Floats | float
    ) -> tuple[WhitenedForm, Weighed, HeldOut]:
        """The longest calibration's offsets as a form, their evidence, and what they take off.

        Args:
            left: (n, 21) the residual, counts.
            noise: (21,) mean square of the whitened residual.
            usual: (21,) log odds that the model's own residual gives them.
        """
        found = {
            seconds: calibrated(self._observations, self._blocks, left, self._row_weights, seconds)
            for seconds in CALIBRATIONS_S
        }
        last = found[CALIBRATIONS_S[-1]]
        white = self._whitening(self._bins.means(left.T[:, :, None]))[:, :, 0]
        table = log_evidence(white, self._ones, self._bins.blocks, self._strengths)
        sums = (table - usual).sum(axis=1)
        removed = {seconds: each.removed for seconds, each in found.items()}
        (form,) = prepared(ContactOffset().form(last.offsets * last.shares, removed), self._whitening)
        weighed = Weighed(mean_odds(sums), 1.0, np.ones(len(CHANNELS)), table[int(sums.argmax())])
        # Sums over rows in counts² become sums over bins in units of the noise.
        unit = noise * self._whitening.scale**2 * self._bins.rows_each
        # They do not age, so that nothing asks in which folds they act.
        return form, weighed, HeldOut(last.gain / unit, last.before / unit, noise, np.zeros_like(last.gain))

    @cached_property
    def _ones(self) -> Floats:
        """(21, bins, k) whitened constants, one for each contact of a block."""
        contact = self._observations.contact[self._bins.order[self._bins.starts]]
        place = np.concatenate(
            [np.unique(contact[block], return_inverse=True)[1] for block in self._bins.blocks]
        )
        ones = np.equal.outer(place, np.arange(place.max() + 1)).astype(np.float64)
        return self._whitening(self._whitening.scale[:, None, None] * ones[None])
