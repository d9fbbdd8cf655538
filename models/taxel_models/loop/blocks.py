"""Blocks: whole segments, or long parts of them. All rows of a block are fitted or held out together."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import RecordingError
from taxel_models.loop.observations import Observations

FOLDS: Final = 40
"""At most, each of one block or a few: more of them tell better whether an effect repeats."""

BLOCK_ROWS: Final = 500
"""The longest block, 5 s: one or two contacts, and much longer than neighbouring rows are correlated."""

MOST_BLOCKS: Final = 300
GUARD_ROWS: Final = 20
"""Rows that are left out at a cut inside a segment: the windows there share samples."""

FEWEST: Final = 16


@dataclass(frozen=True)
class Blocks:
    """The block of each row, and the part that each block belongs to.

    Attributes:
        of_row: (n,) number of the row's block, -1 for a guard row.
        fold: (blocks,) fold of the fit part's cross-validation, -1 for the evaluation part.
    """

    of_row: NDArray[np.int64]
    fold: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.fold)

    @property
    def evaluation(self) -> NDArray[np.bool_]:
        """(n,) rows of the evaluation part."""
        return self._rows(self.fold < 0)

    @property
    def fit(self) -> NDArray[np.bool_]:
        """(n,) rows of the fit part."""
        return self._rows(self.fold >= 0)

    def _rows(self, wanted: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return (self.of_row >= 0) & wanted[self.of_row]


def cut(
    observations: Observations, *, seed: int, held_out: float = 0.3, group: str | None = None
) -> Blocks:
    """Cuts rows into blocks and draws the evaluation part and the folds.

    A block is a whole segment, or a part of about 5 s of a long segment. With a group, each block has one
    value of the group, and all blocks of a value are held out together.

    Args:
        held_out: the share of the blocks, or of the group's values, in the evaluation part.
        group: a covariate whose values are kept together, such as `material`.

    Raises:
        RecordingError: there are fewer than 16 blocks or 4 values, or there is no such covariate.
    """
    of_row = _stretches(observations.segment if group is None else _alike(observations, group))
    count = int(of_row.max()) + 1
    if count < FEWEST:
        raise RecordingError(
            f"{len(observations)} rows make {count} blocks: expected at least {FEWEST}, so about "
            f"{FEWEST * 2} s of recording"
        )
    generator = np.random.default_rng(seed)
    units = _units(observations, of_row, count, group)
    number = int(units.max()) + 1
    order = generator.permutation(number)
    tests = max(1, round(held_out * number))
    fold_of_unit = np.full(number, -1)
    fold_of_unit[order[tests:]] = np.arange(number - tests) % min(FOLDS, number - tests)
    return Blocks(_guarded(observations, of_row), fold_of_unit[units])


def _alike(observations: Observations, group: str) -> NDArray[np.int64]:
    """(n,) number of the stretch of one value, inside a segment, that the row is in."""
    if group not in observations.covariates:
        known = ", ".join(observations.covariates) or "none"
        raise RecordingError(f"no covariate {group!r} to hold out by; the recordings have: {known}")
    changes = (np.diff(observations.covariates[group]) != 0) | (np.diff(observations.segment) != 0)
    numbers = np.concatenate([[0], np.cumsum(changes)])
    if numbers[-1] >= len(numbers) // (4 * GUARD_ROWS):
        raise RecordingError(
            f"{group} changes {numbers[-1]} times in {len(numbers)} rows: too often to hold out by it"
        )
    return np.asarray(numbers)


def _stretches(segment: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) block of each row; none runs from one segment to another."""
    rows = len(segment)
    longest = max(BLOCK_ROWS, rows // MOST_BLOCKS)
    starts = np.flatnonzero(np.diff(segment, prepend=-1))
    lengths = np.diff(starts, append=rows)
    if np.median(lengths) < longest and len(starts) < FEWEST:
        longest = max(1, rows // (2 * FEWEST))
    longest = min(longest, max(100, rows // (2 * FEWEST)))
    blocks, first = np.empty(rows, np.int64), 0
    for start, length in zip(starts, lengths, strict=True):
        pieces = max(1, round(length / longest)) if length > 1.5 * longest else 1
        blocks[start : start + length] = first + np.arange(length) * pieces // length
        first += pieces
    return blocks


def _units(
    observations: Observations, of_row: NDArray[np.int64], count: int, group: str | None
) -> NDArray[np.int64]:
    """(blocks,) the unit that is drawn: a single block, or all blocks of a group's value."""
    if group is None:
        return np.arange(count)
    first_rows = np.flatnonzero(np.diff(of_row, prepend=-1))
    values, units = np.unique(observations.covariates[group][first_rows], return_inverse=True)
    if len(values) < 4:
        raise RecordingError(f"{group} has {len(values)} values: expected at least 4 to hold some out")
    return units


def _guarded(observations: Observations, of_row: NDArray[np.int64]) -> NDArray[np.int64]:
    """Blocks with the rows around a cut inside a segment taken out."""
    guarded = of_row.copy()
    cuts = np.flatnonzero((np.diff(of_row) != 0) & (np.diff(observations.segment) == 0)) + 1
    for cut_at in cuts:
        guarded[max(0, cut_at - GUARD_ROWS) : cut_at + GUARD_ROWS] = -1
    return guarded
