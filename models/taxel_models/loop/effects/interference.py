"""Interference: a wave of constant frequency in some channels, such as the hum of the mains."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.held_out_residual import OwnWave
from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.blocks import GUARD_ROWS
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Remaining
from taxel_models.loop.observations import Observations, runs
from taxel_models.loop.spectral_lines import (
    LOBE,
    PIECE_ROWS,
    LineTest,
    coherence,
    find_lines,
    sharpest,
)
from taxel_models.loop.spectrum import stretches

LOWEST_HZ: Final = 2.0
"""What is slower may be movement, or drift."""

HIGHEST_HZ: Final = 47.0
"""Near half the rate of ticks, a wave has no amplitude of its own."""

HARMONICS: Final = 3
CHANCE: Final = 1e-3
"""That any channel of a recording without interference has a line."""

LEAST_SHARE: Final = 0.05
"""Of a channel's energy that the wave must explain."""

_REPEATS: Final = 0.3
"""Share of the force's variance in one slow wave, from where on the movement counts as periodic."""

_MULTIPLES: Final = 20
"""Of the frequency of a periodic movement, that are no interference."""

_LASTS: Final = 0.3
"""The least of what the wave explains in the median second over its mean: a line that passes is none."""

FOLLOWS: Final = 0.3
"""Share of a wave's power that follows the movement, from where on it is no interference."""

MOST_LINES: Final = 8
"""So many lines are looked at, the strongest first: those before may be of the movement."""

_SLOWEST_HZ: Final = 0.2
_FEWEST_ROWS: Final = 50


class Interference(Effect):
    """A wave with harmonics whose phase follows nothing in the recording."""

    name = "interference"
    looks_at_residual = True
    equation = "delta_c = sum over h of a_hc cos(2 pi h f t) + b_hc sin(2 pi h f t), for each segment"
    source = "F-test of a line beside a smooth spectrum, Percival and Walden 1993, 6.10; Welch 1967"
    signature = "a sharp line of the spectrum that the movement does not have"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        wanted = _bridged(stretches(observations, remaining.fit), observations.segment)
        test = find_lines(remaining.residual, wanted)
        if test is None:
            return
        able = (test.frequencies >= LOWEST_HZ) & (test.frequencies <= HIGHEST_HZ)
        passed = able[:, None] & (test.p_value < CHANCE / (able.sum() * len(CHANNELS) + 1))
        if not passed.any():
            return
        for line in _strongest(test, passed):
            found = self._at(line, test, observations, remaining, wanted, passed[line])
            if found is not None:
                yield found
                return

    def _at(
        self,
        line: int,
        test: LineTest,
        observations: Observations,
        remaining: Remaining,
        wanted: list[slice],
        passed: NDArray[np.bool_],
    ) -> Candidate | None:
        """The interference at one line; None where it is something else."""
        frequency = _refined(observations, remaining, test.frequencies[line], passed)
        if frequency is None:
            return None
        channels = test.p_value[test.nearest(frequency)] < CHANCE / len(CHANNELS)
        channels &= ~_follows(observations, remaining, wanted, frequency)
        if not channels.any() or _repeats(observations, remaining.fit, frequency):
            return None
        orders = [1, *_harmonics(test, frequency, channels)]
        gain = _held_out_gain(observations, remaining, frequency, orders)
        channels &= gain.mean(axis=0) - _usual_share(remaining, frequency) >= LEAST_SHARE
        own = gain[:, channels].sum(axis=1)
        if not channels.any() or np.median(own) < _LASTS * own.mean():
            return None
        return self._with(observations, remaining, frequency, orders, channels)

    def _with(
        self,
        observations: Observations,
        remaining: Remaining,
        frequency: float,
        orders: Sequence[int],
        channels: NDArray[np.bool_],
    ) -> Candidate:
        rows = remaining.fit.copy()
        # A segment of the evaluation part alone has a phase of its own, too.
        for part in runs(observations.segment):
            if rows[part].sum() < _FEWEST_ROWS:
                rows[part] = True
        wave = fitted_wave(observations, remaining.residual, rows, frequency, orders) * channels

        def candidate() -> Candidate:
            names = ", ".join(np.array(CHANNELS)[channels])
            return Candidate(
                self.name,
                f"{frequency:.1f} Hz in {names}",
                Own(wave[:, :, None].astype(np.float32)),
                fitting=Fitting(fixed=True),
                form_parameters={"frequency": (frequency, "Hz")},
                certain=True,
                again=lambda _: candidate(),
            )

        return candidate()


def _bridged(parts: Sequence[slice], segment: NDArray[np.int64]) -> list[slice]:
    """Stretches of the fit part with the guard rows between them; no block is as short as these gaps."""
    joined: list[slice] = []
    for part in parts:
        before = joined[-1] if joined else None
        if (
            before is not None
            and segment[before.start] == segment[part.start]
            and part.start - before.stop <= 2 * GUARD_ROWS
        ):
            joined[-1] = slice(before.start, part.stop)
        else:
            joined.append(part)
    return joined


def fitted_wave(
    observations: Observations,
    values: Floats,
    rows: NDArray[np.bool_],
    frequency: float,
    orders: Sequence[int],
) -> Floats:
    """(n, c) the wave, fitted by least squares beside a line of time in each segment.

    Args:
        values: (n, c).
        rows: (n,) that the wave is fitted to; a segment with fewer than 50 of them has none.
        orders: of the harmonics; 1 is the frequency itself.
    """
    wave = np.zeros_like(values)
    for part in runs(observations.segment):
        used = rows[part]
        if used.sum() < _FEWEST_ROWS:
            continue
        time = observations.time_s[part] - observations.time_s[part.start]
        phase = 2 * np.pi * frequency * time[:, None] * np.array(orders)
        trend = np.column_stack([np.ones_like(time), time])
        terms = np.hstack([trend, np.cos(phase), np.sin(phase)])
        weights = np.linalg.lstsq(terms[used], values[part][used], rcond=None)[0]
        wave[part] = terms[:, 2:] @ weights[2:]
    return wave


def _held_out_gain(
    observations: Observations, remaining: Remaining, frequency: float, orders: Sequence[int]
) -> Floats:
    """(seconds, 21) energy that the wave explains of each second when fitted to those beside it.

    Its unit is the mean energy of a second of the channel, so that the mean is the share explained.
    """
    values, fit = remaining.residual, remaining.fit
    even = np.floor(observations.time_s) % 2 == 0
    gain = np.zeros_like(values)
    for first, second in ((even, ~even), (~even, even)):
        wave = fitted_wave(observations, values, fit & first, frequency, orders)
        gain[second] = (values**2 - (values - wave) ** 2)[second]
    second_of = np.cumsum(np.diff(even[fit], prepend=even[fit][0]) != 0)
    sums = np.array([np.bincount(second_of, column) for column in gain[fit].T]).T
    energy = (values[fit] ** 2).sum(axis=0) / len(sums)
    return np.asarray(sums / np.maximum(energy, 1e-9))


def own_waves(observations: Observations, rows: NDArray[np.bool_]) -> tuple[OwnWave, ...]:
    """Waves of a model's own residual in some rows (n,) that training held out, the strongest first.

    A line is one here by the chance of a single test: what a short recording hardly shows may be clear in
    another one.
    """
    remaining = Remaining(observations.residual, rows, np.ones(len(observations)))
    test = find_lines(remaining.residual, stretches(observations, rows))
    if test is None:
        return ()
    able = (test.frequencies >= LOWEST_HZ) & (test.frequencies <= HIGHEST_HZ)
    passed = able[:, None] & (test.p_value < CHANCE)
    size, found = (observations.residual[rows] ** 2).mean(axis=0), []
    for line in _strongest(test, passed):
        frequency = float(test.frequencies[line])
        frequency = _refined(observations, remaining, frequency, passed[line]) or frequency
        share = _held_out_gain(observations, remaining, frequency, [1]).mean(axis=0)
        energy = np.maximum(share, 0.0) * size
        found.append(OwnWave(frequency_hz=round(frequency, 2), energy=tuple(energy.round(4).tolist())))
    return tuple(found)


def _usual_share(remaining: Remaining, frequency: float) -> Floats:
    """(21,) share of each channel's energy that a usual wave explains near a frequency, Hz."""
    near = [
        wave.energy
        for wave in remaining.waves
        if abs(wave.frequency_hz - frequency) <= LOBE / (PIECE_ROWS * TICK_S)
    ]
    energy = (remaining.residual[remaining.fit] ** 2).mean(axis=0)
    return np.asarray(np.max(near, axis=0, initial=0.0) / np.maximum(energy, 1e-9))


def _refined(
    observations: Observations, remaining: Remaining, near: float, channels: NDArray[np.bool_]
) -> float | None:
    """The line's frequency, Hz, by the phases of whole segments; None if there is no line in the range."""
    values = remaining.residual[:, channels]
    values = values / np.maximum(values[remaining.fit].std(axis=0), 1e-9)
    found = sharpest(values, observations.segment, remaining.fit, near - 0.4, near + 0.4)
    return found if found is not None and LOWEST_HZ <= found <= HIGHEST_HZ else None


def _harmonics(test: LineTest, frequency: float, channels: NDArray[np.bool_]) -> list[int]:
    """The orders of harmonics that one of the channels has. Those beyond half the rate are folded."""
    rate, found = 1 / TICK_S, []
    for order in range(2, HARMONICS + 1):
        folded = abs((order * frequency + rate / 2) % rate - rate / 2)
        chance = test.p_value[test.nearest(folded)][channels]
        if LOWEST_HZ <= folded <= HIGHEST_HZ and (chance < CHANCE / len(CHANNELS)).any():
            found.append(order)
    return found


def _strongest(test: LineTest, passed: NDArray[np.bool_]) -> list[int]:
    """The places of the strongest lines, the strongest first, each far enough from those before it."""
    size = np.where(passed, test.excess, 0.0).sum(axis=1)
    chosen: list[int] = []
    for place in np.argsort(-size).tolist():
        if size[place] <= 0 or len(chosen) == MOST_LINES:
            break
        if all(abs(place - other) > LOBE for other in chosen):
            chosen.append(place)
    return chosen


def _follows(
    observations: Observations, remaining: Remaining, wanted: list[slice], frequency: float
) -> NDArray[np.bool_]:
    """(21,) whether a channel's wave keeps its phase to one of the force or of the prediction."""
    moving = np.hstack([observations.force, observations.pressed[:, None], observations.predicted])
    share, pieces = coherence(remaining.residual, moving, wanted, frequency)
    # Of unrelated signals, (1 - share)^(pieces - 1) is the chance of a share as large.
    by_chance = 1.0 - (CHANCE / share.size) ** (1.0 / max(pieces - 1, 1))
    return np.asarray((share > max(by_chance, FOLLOWS)).any(axis=1))


def _repeats(observations: Observations, fit: NDArray[np.bool_], frequency: float) -> bool:
    """Whether a movement repeats so that the frequency is a multiple of its own."""
    pressed = observations.pressed[:, None]
    slow = sharpest(pressed, observations.segment, fit, _SLOWEST_HZ, LOWEST_HZ)
    if slow is None:
        return False
    wave = fitted_wave(observations, pressed, fit, slow, [1])
    if wave[fit].var() < _REPEATS * pressed[fit].var():
        return False
    resolution = 1.0 / observations.usual_segment_s
    order = round(frequency / slow)
    return order <= _MULTIPLES and abs(frequency - order * slow) < resolution * (1.0 + 0.05 * order)
