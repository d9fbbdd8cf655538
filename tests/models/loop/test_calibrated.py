"""Offsets of contacts, told by a calibration at the start of each."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from taxel.channels import CHANNELS
from taxel.corrections import Calibrated, Correction, OffsetCalibration
from taxel.windows import WindowSpec
from taxel_models.loop.next_recording.fitted import Fitted
from taxel_models.loop.pipeline import LoopResult, LoopSettings, run_loop
from taxel_models.recordings import Recording

Make = Callable[..., Recording]

CONTACT: Final = 500
"""Rows from one gap to the next."""

CALIBRATION_S: Final = 0.5


def result_with(smooth: Any, make: Make, offset: Any, contact: int = CONTACT) -> LoopResult:
    """The loop on contacts with offsets, a function of their number and of the seconds since they began."""
    recording = make(20_000, noise=2.0)
    rows = np.arange(len(recording))
    apart = recording.samples.time_ns + 1_000_000_000 * (rows // contact)
    channels = recording.channels + offset(rows // contact, rows % contact / 100.0)
    with_offset = replace(
        recording,
        samples=replace(recording.samples, time_ns=apart),
        channels=np.clip(np.rint(channels), 0, 4095),
    )
    return run_loop(smooth, [with_offset], LoopSettings(calibration_s=CALIBRATION_S))


def drawn(seed: int) -> np.ndarray:
    """(contacts, 21) counts."""
    return np.random.default_rng(seed).normal(size=(200, 21)) * 20.0


def test_an_offset_that_stays_is_not_said_to_fade(smooth: Any, make: Make) -> None:
    def offset(contact: np.ndarray, seconds: np.ndarray) -> np.ndarray:
        return drawn(0)[contact]

    result = result_with(smooth, make, offset)
    (effect,), (named,) = result.findings.effects, result.attribution.named
    assert effect.form == "of each contact, from a calibration"
    assert effect.explained > 0.9
    assert not Fitted.of(named).foretells


def test_one_that_fades_is_served_with_its_age(smooth: Any, make: Make) -> None:
    def offset(contact: np.ndarray, seconds: np.ndarray) -> np.ndarray:
        lasts = 0.3 + 0.7 * np.exp(-np.maximum(seconds - CALIBRATION_S, 0.0) / 1.0)
        return drawn(0)[contact] * lasts[:, None]

    result = result_with(smooth, make, offset)
    (effect,) = result.findings.effects
    assert effect.form == "of each contact, from a calibration, fading with 1 s"
    assert effect.needs[-1] == "calibration_age"
    values = {figure.name: figure.value for figure in effect.parameters}
    stays, fades = (
        np.array([values[f"share that {what} {one}"] for one in CHANNELS]) for what in ("stays", "fades")
    )
    # Windows look 0.1 s back, so that a calibration ends that much after it does in the channels. Both
    # shares are a little low, as all weights are shrunk by what chance gives.
    np.testing.assert_allclose(fades / stays, 0.7 * np.exp(-0.1) / 0.3, rtol=0.1)
    assert 0.22 < stays.mean() < 0.31

    spec = WindowSpec.of(smooth.manifest.window.combination, 0)
    extras = (*smooth.manifest.window.extras, *result.new.extras)
    correction = Correction(result.new.effects, spec, extras)
    everything = result.served_windows(len(result.observations))
    np.testing.assert_allclose(correction.apply(smooth.predict, everything), result.after, atol=0.02)

    # As a client would: a row three seconds into a contact, by what the calibration gives it.
    taken = result.observations.calibration
    assert taken is not None
    row = int(np.flatnonzero(np.isclose(taken.age_s, 3.0, atol=0.001))[0])
    given = OffsetCalibration(taken.offsets[row]).extras_after(3.0)
    window = [*result.observations.windows[row], *(given[extra.name] for extra in result.new.extras)]
    alone = correction.apply(smooth.predict, np.array([window], dtype=np.float32))
    np.testing.assert_allclose(alone[0], result.after[row], atol=0.02)


def test_what_all_channels_share_is_told_by_all_of_them(smooth: Any, make: Make) -> None:
    """While it is calibrated each channel errs by itself, too, and some contacts are far off."""
    shared, own = drawn(1).mean(axis=1, keepdims=True) * 5.0, drawn(2)
    own[::20] *= 20.0

    def offset(contact: np.ndarray, seconds: np.ndarray) -> np.ndarray:
        at_first = (seconds < CALIBRATION_S + 0.1)[:, None]
        return shared[contact] + np.where(at_first, own[contact], 0.0)

    result = result_with(smooth, make, offset, contact=120)
    (effect,) = result.findings.effects
    assert "from a calibration of all channels" in effect.form
    assert {figure.name.rsplit(" ", 1)[0] for figure in effect.parameters[1:]} <= {
        "share that stays",
        "share that fades",
    }
    (term,) = result.new.effects[0].terms
    assert isinstance(term, Calibrated)
    # An offset that counts for other channels ends within a few usual ones.
    usual = np.sqrt(drawn(1).mean(axis=1).var() * 25.0 + 400.0)
    assert (np.array(term.limits) < 5.0 * usual).all()
    assert effect.explained > 0.4
