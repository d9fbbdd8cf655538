"""What runs along with what, before anything is fitted."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taxel_models.loop.confounding import CONSTANT, ORDER, PHASE, TIME, confounding
from taxel_models.loop.observations import Observations, gather
from taxel_models.recordings import Recording


def shares(observations: Observations) -> dict[tuple[str, str], float]:
    return {(one.quantity, one.along): one.share for one in confounding(observations)}


def test_random_contacts_run_along_with_nothing_but_the_clock(observations: Observations) -> None:
    """The temperature rises with time; the material changes by chance."""
    found = shares(observations)
    along = {pair for pair, share in found.items() if share > 0.35 and pair[1] != CONSTANT}
    assert along <= {("temperature", TIME), ("temperature", ORDER), ("force", PHASE)}
    assert found["temperature", TIME] > 0.8
    assert all(0.0 <= share <= 1.0 for share in found.values())
    assert list(found.values()) == sorted(found.values(), reverse=True)


def test_materials_one_after_another_run_along_with_time(
    smooth: Any, make: Callable[..., Recording]
) -> None:
    recording = make()
    rows = len(recording)
    material = np.repeat(np.arange(1.0, 6.0), rows // 5)
    sequence = replace(recording, covariates={"material": material})
    found = shares(gather(smooth, [sequence]))
    assert found["material", TIME] > 0.8
    assert found["material", ORDER] > 0.8
    assert found["temperature", "material"] > 0.7


def test_a_place_that_follows_the_phase_is_told(smooth: Any, make: Callable[..., Recording]) -> None:
    """A slide, as a robot does it: the position is the time since the contact began."""
    recording = make()
    time = np.arange(len(recording)) % 300 / 100.0
    pressed = (time > 0.5).astype(float)
    samples = replace(
        recording.samples,
        position=np.column_stack([0.06 * time, np.zeros((len(time), 2))]),
        force=np.column_stack([np.zeros((len(time), 2)), pressed]),
    )
    found = shares(gather(smooth, [replace(recording, samples=samples)]))
    assert found["place", PHASE] == pytest.approx(0.98, abs=0.03)
    assert found["place", TIME] < 0.2


def test_what_a_constant_explains_depends_on_free_air_and_on_forces_that_fall(
    smooth: Any, make: Callable[..., Recording]
) -> None:
    recording = make()
    usual = shares(gather(smooth, [recording]))
    assert usual["friction", CONSTANT] < 0.3
    # Ten presses that only grow, each a segment of its own.
    rows = len(recording) // 10
    growing = np.tile(np.linspace(1.0, 8.0, rows), 10)
    force = np.column_stack([np.zeros((len(growing), 2)), -growing])
    pauses = np.repeat(np.arange(10) * 10**9, rows)
    samples = recording.samples
    pressed = replace(samples, force=force, time_ns=samples.time_ns + pauses)
    never_off = shares(gather(smooth, [replace(recording, samples=pressed)]))
    assert never_off["friction", CONSTANT] > 0.7
    assert never_off["warming by contact", CONSTANT] > 0.7


def test_few_contacts_tell_nothing(smooth: Any, make: Callable[..., Recording]) -> None:
    assert confounding(gather(smooth, [make(600)])) == ()
