"""A gain is told from counts that are added with the same course, also where these end at a limit."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.held_out_residual import HeldOutResidual
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

from .tared import Tared, with_counts

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


@pytest.fixture(scope="module")
def tared(smooth: Any) -> Tared:
    return Tared(smooth)


@pytest.fixture(scope="module")
def known(tared: Tared, make: Callable[..., Recording]) -> HeldOutResidual:
    found = held_out_residual(tared, [tared.of(make(seed=8, materials=False))])
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("lost", "found"),
    [
        (lambda age, own, other: age * 40.0, []),
        (lambda age, own, other: age * 0.5 * own, ["gain"]),
        (lambda age, own, other: 20.0, []),
        (lambda age, own, other: -0.3 * other, ["crosstalk"]),
    ],
    ids=["more and more counts", "a share of its signal", "counts", "a leak"],
)
def test_what_a_tared_electrode_loses_is_a_gain_or_a_leak_if_it_is_a_share_of_a_signal(
    tared: Tared,
    known: HeldOutResidual,
    make: Callable[..., Recording],
    lost: Callable[..., Any],
    found: list[str],
) -> None:
    """Its counts end at 0."""
    recording = tared.of(make(seed=4, materials=False))
    counts, column, other = recording.channels.copy(), CHANNELS.index("e4"), CHANNELS.index("e12")
    counts[:, column] -= lost(np.linspace(0.0, 1.0, len(counts)), counts[:, column], counts[:, other])
    changed = with_counts(recording, counts)
    named = run_loop(tared, [changed], LoopSettings(), reference=known).findings.effects
    assert [one.name for one in named if one.name in ("gain", "crosstalk")] == found


def test_offsets_of_a_tared_sensor_are_named_and_served_within_its_limits(
    tared: Tared, known: HeldOutResidual, make: Callable[..., Recording]
) -> None:
    """Where they are taken away, they show only while it is pressed, as a loss of sensitivity would."""
    recording = tared.of(make(seed=4, materials=False))
    offsets = np.random.default_rng(3).normal(size=21) * recording.channels.std(axis=0)
    changed = with_counts(recording, recording.channels + offsets)
    assert (changed.channels == 0).mean() > 0.2
    found = run_loop(tared, [changed], LoopSettings(), reference=known)
    assert [one.name for one in found.findings.effects] == ["offset"]
    terms = [term for effect in found.new.effects for term in effect.terms]
    assert [term.kind for term in terms] == ["weighted", "count_limits"]
    offset = found.attribution.named[0].weights[:, 0]
    assert (np.abs(offset - offsets) < 4.0 + 0.05 * np.abs(offsets)).all()
    assert found.findings.after["norm_mae"] < 0.3 * found.findings.before["norm_mae"]
