"""Crossed channels: each holds the signal of another one, as where two wires are exchanged."""

from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from taxel_models.loop.basis import Floats

STRETCHES: Final = 10
"""Parts of the recording. In each, a channel's constant is its own, and tells nothing of which it is."""

MUCH: Final = 0.7
"""Channels are crossed if the others' predictions leave at most this share of the squares, in the geometric
mean of shapes and sizes: where they leave more, the channels are alike, or something else is wrong. Signals
of neighbours have much the same shape, and other sizes."""

MUCH_OF_PART: Final = 0.5
"""The same of a part of a recording: it tells less, and which part it is was chosen."""

NEARLY_ALL: Final = 0.8
"""Share of the stretches in which the others' predictions have to be nearer."""

LATE: Final = 0.3
"""The last part of a recording, by which channels are found that were crossed in its course."""


def crossed_since(measured: Floats, predicted: Floats) -> tuple[NDArray[np.int64], int]:
    """Which channels are crossed at the end of a recording, and the row (of n) since when.

    Where all of it is not crossed, its last part may be: the moment is the one that leaves the least
    squares of both sides. Before it, each channel must hold its own signal as clearly as another one after.

    Args:
        measured: (n, 21) counts.
        predicted: (n, 21) counts, from the model.
    """
    whole = late = crossed_channels(measured, predicted)
    own, begins = np.arange(len(whole)), int((1.0 - LATE) * len(measured))
    if (whole == own).all():
        late = crossed_channels(measured[begins:], predicted[begins:], MUCH_OF_PART)
    moved = np.flatnonzero(late != own)
    if not len(moved):
        return own, 0
    # About the means of the parts that are surely on either side, so that offsets tell nothing.
    early = slice(0, len(measured) // 10)

    def squares(channels: NDArray[np.int64], part: slice) -> Floats:
        wrong = measured[:, moved] - predicted[:, channels]
        wrong = wrong - wrong[part].mean(axis=0)
        return np.asarray((wrong**2 / np.maximum(measured[:, moved].var(axis=0), 1e-9)).sum(axis=1))

    gained = squares(moved, early) - squares(late[moved], slice(begins, None))
    # (n + 1,) what is left if it began at each row.
    left = np.concatenate([[0.0], np.cumsum(gained)])
    since = int(left.argmin())
    if since <= early.stop:
        return whole, 0
    before = crossed_channels(measured[:since, late], predicted[:since], MUCH_OF_PART)
    found = own.copy()
    for cycle in _cycles(late):
        if (before[cycle] == late[cycle]).all():
            found[cycle] = late[cycle]
    return (found, since) if (found != own).any() else (whole, 0)


def crossed_channels(measured: Floats, predicted: Floats, much: float = MUCH) -> NDArray[np.int64]:
    """(21,) the channel whose signal each channel holds; its own number where it holds its own.

    Which channels are crossed is an assignment (Kuhn 1955). It must hold for the shapes of the signals,
    which neither offsets nor gains change, and for their sizes as well.

    Args:
        measured: (n, 21) counts.
        predicted: (n, 21) counts, from the model.
        much: see `MUCH`.
    """
    own = np.arange(measured.shape[1])
    parts = [part for part in np.array_split(np.arange(len(measured)), STRETCHES) if len(part) > 1]
    if not parts:
        return own
    seen, foretold = (_sums(values, parts) for values in ((measured, measured), (predicted, predicted)))
    both = _sums((measured, predicted), parts)
    size = seen.sum(axis=0).diagonal()
    expected = foretold.sum(axis=0).diagonal()
    moves = (size > 0) & (expected > 0)
    if moves.sum() < 2:
        return own
    # (stretches, 21, 21) squares that channel i has about the prediction of channel j.
    squares = (
        seen.diagonal(axis1=1, axis2=2)[:, :, None]
        - 2 * both
        + foretold.diagonal(axis1=1, axis2=2)[:, None, :]
    )
    alike = np.maximum(both.sum(axis=0), 0.0) ** 2
    shape = 1.0 - alike / np.maximum(np.outer(size, expected), 1e-12)
    live = np.flatnonzero(moves)
    relative = squares / np.maximum(size, 1e-12)[:, None]
    whole = relative.sum(axis=0)

    def nearer(channels: NDArray[np.int64], others: NDArray[np.int64]) -> bool:
        """Whether some channels are crossed, by what they tell together."""
        falls = relative[:, channels, others].sum(axis=1) < relative[:, channels, channels].sum(axis=1)
        crossed = shape[channels, others].sum() * whole[channels, others].sum()
        uncrossed = shape[channels, channels].sum() * whole[channels, channels].sum()
        if crossed > much**2 * uncrossed or falls.mean() < NEARLY_ALL:
            return False
        # A few rows that jump far away are most of a sum of squares. Each channel must err less otherwise.
        errors = (
            _scatter(measured[:, channels] - predicted[:, each], parts) for each in (others, channels)
        )
        return bool(np.less(*errors).all())

    found, assigned = own.copy(), own.copy()
    assigned[live] = live[linear_sum_assignment(shape[np.ix_(live, live)])[1]]
    for cycle in _cycles(assigned):
        # Two that are crossed may draw a third one in that is alike: in a longer cycle, each must tell.
        each = cycle[:, None] if len(cycle) > 2 else cycle[None]
        if all(nearer(channels, assigned[channels]) for channels in each):
            found[cycle] = assigned[cycle]
            continue
        for pair in map(np.array, combinations(cycle, 2)):
            if (found[pair] == pair).all() and nearer(pair, pair[::-1]):
                found[pair] = pair[::-1]
    return found


def _scatter(errors: Floats, parts: list[NDArray[np.int64]]) -> Floats:
    """(c,) mean size of errors (n, c) about the median of each stretch."""
    sizes = [np.abs(errors[part] - np.median(errors[part], axis=0)).sum(axis=0) for part in parts]
    return np.asarray(np.sum(sizes, axis=0) / len(errors))


def _sums(values: tuple[Floats, Floats], parts: list[NDArray[np.int64]]) -> Floats:
    """(stretches, 21, 21) sums of products about the means of each stretch."""
    first, second = values
    return np.array(
        [
            (first[part] - first[part].mean(axis=0)).T @ (second[part] - second[part].mean(axis=0))
            for part in parts
        ]
    )


def _cycles(assigned: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Channels that are exchanged among themselves."""
    cycles, left = [], set(np.flatnonzero(assigned != np.arange(len(assigned))).tolist())
    while left:
        cycle = [min(left)]
        while (following := int(assigned[cycle[-1]])) != cycle[0]:
            cycle.append(following)
        left -= set(cycle)
        cycles.append(np.array(cycle))
    return cycles
