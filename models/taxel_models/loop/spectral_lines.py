"""Spectral lines: frequencies with more power than the smooth spectrum around them gives by chance."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats

from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats
from taxel_models.loop.observations import runs

PIECE_ROWS: Final = 256
"""Of the spectrum: 2.56 s, so that lines are 0.4 Hz apart."""

_AROUND: Final = 8
LOBE: Final = 2
"""A line spreads over so many frequencies to each side (Hann window)."""

_FEWEST_AROUND: Final = 3

_INDEPENDENT: Final = 1.0 / (1.0 + 2.0 / 36.0)
"""How many independent pieces each one counts for: Hann windows that overlap by half (Welch 1967)."""

_OF_MEDIAN: Final = 0.64 / 1.5
"""How many independent frequencies each one around a line counts for: the median of normal values has an
efficiency of 2/pi, and the Hann window spreads each frequency over 1.5."""


@dataclass(frozen=True)
class LineTest:
    """Each frequency's power beside the power around it.

    Attributes:
        frequencies: (m,), Hz.
        excess: (m, c) power beyond what is usual around the frequency, over the column's mean power.
        p_value: (m, c) the chance of a power as large; 1 at the ends, where too few frequencies are near.
    """

    frequencies: Floats
    excess: Floats
    p_value: Floats

    def nearest(self, frequency: float) -> int:
        """The place of the nearest frequency."""
        return int(np.argmin(np.abs(self.frequencies - frequency)))


def find_lines(values: Floats, wanted: list[slice]) -> LineTest | None:
    """Test each column's spectrum for lines.

    The spectrum is the mean over pieces of the stretches (Welch 1967); each piece counts alike. The
    reference is the median over the frequencies to both sides. The ratio of two independent estimates of a
    smooth spectrum has the F distribution (Percival and Walden 1993, 6.10).

    Args:
        values: (n, c).
        wanted: stretches of rows; those shorter than a piece are left out.

    Returns:
        None where no stretch is as long as a piece.
    """
    pieces = _pieces(wanted)
    if not pieces:
        return None
    total = np.zeros((PIECE_ROWS // 2 + 1, values.shape[1]))
    for piece in pieces:
        frequencies, power = signal.periodogram(
            values[piece], 1 / TICK_S, window="hann", detrend="linear", axis=0
        )
        total += power / np.maximum(power[_AROUND // 2 :].mean(axis=0), 1e-12)
    total /= len(pieces)
    freedom = 2.0 * max(1.0, len(pieces) * _INDEPENDENT)
    excess, chance = np.zeros_like(total), np.ones_like(total)
    for place in range(len(total)):
        reach = min(_AROUND, place - 1, len(total) - 2 - place)
        if reach < LOBE + _FEWEST_AROUND:
            continue
        offsets = np.arange(LOBE + 1, reach + 1)
        near = total[np.concatenate([place - offsets, place + offsets])]
        usual = np.median(near, axis=0) * freedom / stats.chi2.median(freedom)
        ratio = total[place] / np.maximum(usual, 1e-12)
        chance[place] = stats.f.sf(ratio, freedom, freedom * len(near) * _OF_MEDIAN)
        excess[place] = total[place] - usual
    return LineTest(np.asarray(frequencies), excess, chance)


def coherence(first: Floats, second: Floats, wanted: list[slice], frequency: float) -> tuple[Floats, int]:
    """How much of one signal's power at a frequency, Hz, follows another signal with a constant phase.

    The magnitude-squared coherence over the pieces of the stretches (Carter 1987): of two signals that
    have nothing to do with each other, it is near one over the number of pieces.

    Args:
        first: (n, a).
        second: (n, b).

    Returns:
        (a, b) shares, and the number of independent pieces.
    """
    pieces = _pieces(wanted)
    window = signal.get_window("hann", PIECE_ROWS)
    # The line is taken off the wave once, not off each piece. The products are the same, since taking off a
    # line is a symmetric projection.
    wave = signal.detrend(window * np.exp(-2j * np.pi * frequency * TICK_S * np.arange(PIECE_ROWS)))
    one, other = (np.array([wave @ values[piece] for piece in pieces]) for values in (first, second))
    cross = np.abs(one.T @ other.conj()) ** 2
    power = np.outer((np.abs(one) ** 2).sum(axis=0), (np.abs(other) ** 2).sum(axis=0))
    independent = max(1, round(len(pieces) * _INDEPENDENT))
    return np.asarray(cross / np.maximum(power, 1e-24)), independent


def _pieces(wanted: list[slice]) -> list[slice]:
    return [
        slice(start, start + PIECE_ROWS)
        for stretch in wanted
        for start in range(stretch.start, stretch.stop - PIECE_ROWS + 1, PIECE_ROWS // 2)
    ]


def sharpest(
    values: Floats, segment: NDArray[np.int64], rows: NDArray[np.bool_], low: float, high: float
) -> float | None:
    """The frequency between two others, Hz, of the wave of constant frequency that explains most.

    The wave has its own phase and amplitude in each segment and column. Its periodograms are summed over
    segments.

    Args:
        values: (n, c); a column with a larger SD counts more.
        segment: (n,) number of the segment.
        rows: (n,) which rows count.

    Returns:
        None where the best frequency is at an end.
    """
    parts = runs(segment)
    longest = max(part.stop - part.start for part in parts)
    count = int(min(20_000, max(33, np.ceil((high - low) * 16 * longest * TICK_S))))
    power = np.zeros(count)
    for part in parts:
        kept = rows[part]
        if not kept.any():
            continue
        own = np.where(kept[:, None], values[part] - values[part][kept].mean(axis=0), 0.0)
        found = signal.zoom_fft(own, [low, high], count, fs=1 / TICK_S, axis=0, endpoint=True)
        power += (np.abs(found) ** 2).sum(axis=1) / kept.sum()
    best = int(np.argmax(power))
    return None if best in (0, count - 1) else float(np.linspace(low, high, count)[best])
