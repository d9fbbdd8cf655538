"""What the loop says of a tared sensor, whose counts end at 0."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel.held_out_residual import HeldOutResidual
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.reference.held_out import held_out_residual
from taxel_models.recordings import Recording

from .tared import Tared, with_counts


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
        pytest.param(lambda age, own, other: 20.0, [], marks=pytest.mark.long),
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
