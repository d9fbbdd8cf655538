"""Counts at rest: the converter's own, or tared ones. A model and recordings must have the same kind."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.models.loop.inference.tared import Tared

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel.errors import RecordingError
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.resting import check_scale
from taxel_models.recordings import Recording

Make = Callable[..., Recording]


def test_a_raw_model_and_tared_recordings_are_refused(smooth: Any, make: Make) -> None:
    recording = make()
    tared = Tared(smooth)
    for model, other, text in (
        (smooth, tared.of(recording), "look tared, and network-b/1 gives"),
        (tared, recording, "look raw, and network-b/1 gives"),
    ):
        with pytest.raises(RecordingError, match=text):
            run_loop(model, [other], LoopSettings())


def test_a_finger_without_power_is_not_taken_for_a_tared_one(smooth: Any, make: Make) -> None:
    recording = make()
    channels = recording.channels.copy()
    channels[:, ELECTRODE_COLUMNS] = 0
    check(smooth, replace(recording, channels=channels))


@pytest.mark.parametrize("offset", [-900.0, 900.0])
def test_an_offset_of_all_electrodes_is_none(smooth: Any, make: Make, offset: float) -> None:
    recording = make()
    channels = recording.channels.copy()
    channels[:, ELECTRODE_COLUMNS] = np.clip(channels[:, ELECTRODE_COLUMNS] + offset, 0, 4095)
    check(smooth, replace(recording, channels=channels))


def check(smooth: Any, recording: Recording) -> None:
    force = recording.samples.force
    predicted = smooth.counts(recording.samples.position, force)
    assert predicted.shape == (len(recording), len(CHANNELS))
    check_scale("smooth/1", np.linalg.norm(force, axis=1), predicted, recording.channels)
