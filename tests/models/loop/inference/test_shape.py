"""A gain is told from counts that are added with the same course, also where these end at a limit."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel_models.loop.basis import Own, Shared
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.shape import is_added
from taxel_models.loop.inference.whitening import Bins
from taxel_models.loop.observations import Observations
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.reference.held_out import held_out_residual
from taxel_models.recordings import Recording

CHANNEL = 7


def judged(observations: Observations, course: Any, change: Any, *, own: bool = False) -> bool:
    """Of a tared channel: what it reads above rest, pressed or not, with noise and a change."""
    random = np.random.default_rng(1)
    rows = len(observations)
    contact = (
        (np.arange(rows) // 150) % 2 * np.repeat(random.uniform(20.0, 120.0, rows // 150 + 1), 150)[:rows]
    )
    signal = np.tile(contact[:, None], (1, 21))
    time = np.linspace(0.0, 1.0, rows)
    counts = signal[:, CHANNEL] + 3.0 * random.normal(size=rows) + change(signal[:, CHANNEL], time)
    measured = signal.copy()
    measured[:, CHANNEL] = np.clip(np.rint(counts), 0, COUNTS_MAX)
    features = np.column_stack([np.ones(rows), *([time] if course == "ageing" else [])])
    basis = Own(np.ones((rows, 21, 1), np.float32)) if own else Shared(features, signal)
    bins = Bins.of(cut(observations, seed=0), DECLARED.bin_s)
    return is_added(Candidate("gain", course, basis), CHANNEL, measured, measured - signal, bins)


@pytest.mark.parametrize("course", ["constant", "ageing"])
@pytest.mark.parametrize("share", [-0.7, -0.2, 0.3])
def test_a_gain_is_none(observations: Observations, course: str, share: float) -> None:
    def change(signal: Any, time: Any) -> Any:
        return share * signal * (time if course == "ageing" else 1.0)

    assert not judged(observations, course, change)


@pytest.mark.parametrize("course", ["constant", "ageing"])
@pytest.mark.parametrize("counts", [-40.0, -15.0, 25.0])
def test_counts_are_whether_they_end_at_a_limit_or_not(
    observations: Observations, course: str, counts: float
) -> None:
    def change(_: Any, time: Any) -> Any:
        return counts * (time if course == "ageing" else np.ones_like(time))

    assert judged(observations, course, change)


def test_a_gain_whose_mean_the_model_absorbed_is_none(observations: Observations) -> None:
    assert not judged(observations, "constant", lambda signal, _: 0.3 * (signal - signal.mean()))


def test_a_form_that_follows_no_signal_is_none(observations: Observations) -> None:
    assert not judged(observations, "constant", lambda _, time: 25.0 * np.ones_like(time), own=True)


class Tared:
    """The smooth model of a tared finger: each channel says how far it is from rest."""

    def __init__(self, smooth: Any) -> None:
        self.manifest, self._smooth = smooth.manifest, smooth
        self._rest = smooth.counts(np.zeros((1, 3)), np.zeros((1, 3)))

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.abs(self._smooth.predict(windows) - self._rest).astype(np.float32)

    predict_base = predict

    def of(self, recording: Recording) -> Recording:
        """A recording of the smooth model, with the same noise."""
        own = self._smooth.counts(recording.samples.position, recording.samples.force)
        counts = np.abs(own - self._rest) + (recording.channels - own)
        return replace(recording, channels=np.clip(np.rint(counts), 0, COUNTS_MAX))


@pytest.mark.parametrize(
    ("lost", "found"),
    [(lambda _: 40.0, []), (lambda signal: 0.5 * signal, ["gain"])],
    ids=["counts", "share"],
)
def test_what_a_tared_electrode_loses_is_a_gain_if_it_is_a_share_of_its_signal(
    smooth: Any, make: Callable[..., Recording], lost: Callable[[Any], Any], found: list[str]
) -> None:
    """It loses more and more over the session, and its counts end at 0."""
    tared = Tared(smooth)
    known = held_out_residual(tared, [tared.of(make(seed=8, materials=False))])
    recording = tared.of(make(seed=4, materials=False))
    counts, column = recording.channels.copy(), CHANNELS.index("e4")
    counts[:, column] -= np.linspace(0.0, 1.0, len(counts)) * lost(counts[:, column])
    changed = replace(recording, channels=np.clip(np.rint(counts), 0, COUNTS_MAX))
    named = run_loop(tared, [changed], LoopSettings(), reference=known).findings.effects
    assert [one.name for one in named if one.name == "gain"] == found
