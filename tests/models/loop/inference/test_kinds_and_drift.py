"""Kinds that were recorded one after the other, and what changes with the time."""

from dataclasses import replace
from typing import Any

import numpy as np

from taxel_models.recovery.injection import Injection

from .selected import Make, add, attributed, into, names, only


def one_kind_after_another(injection: Injection, count: int = 7) -> np.ndarray:
    """(n,) so many kinds, each recorded at a time of its own."""
    rows = len(injection.recording)
    kinds = np.minimum(np.arange(rows) * count // rows, count - 1)
    injection.recording = replace(injection.recording, covariates={"material": kinds.astype(float)})
    return kinds


def test_a_drift_inside_kinds_of_a_covariate_is_no_covariate(smooth: Any, make: Make) -> None:
    """Each kind is recorded at its own time, so that its mean tells when it was."""
    injection = into(make, 9_000)
    kinds = one_kind_after_another(injection, 5)
    clock = np.linspace(-1.0, 1.0, len(kinds))
    add(injection, clock[:, None] * np.resize([25.0, -30.0, 15.0], 21))
    assert names(attributed(smooth, injection.recording, exclude=("temperature",)))[0] == "drift"


def test_kinds_are_told_from_time(smooth: Any, make: Make) -> None:
    injection = into(make, 9_000)
    kinds = injection.recording.covariates["material"].astype(int)
    counts = np.random.default_rng(1).normal(size=(6, 21)) * 12.0
    add(injection, counts[kinds] - counts[kinds].mean(axis=0))
    assert only(attributed(smooth, injection.recording)).name == "covariate:material"


def test_kinds_that_follow_each_other_are_told_from_a_drift(smooth: Any, make: Make) -> None:
    """A drift has one course in all channels; constants of kinds are as many as there are kinds."""
    injection = into(make, 9_000)
    kinds = one_kind_after_another(injection)
    counts = np.random.default_rng(1).uniform(-1.0, 1.0, (7, 21)) * 20.0
    add(injection, counts[kinds] - counts[kinds].mean(axis=0))
    found = attributed(smooth, injection.recording, exclude=("temperature",))
    assert names(found) == ["covariate:material"]
    (drift,) = [one for one in found.rejected if one.name == "drift"]
    # Straight pieces of each channel's own follow three quarters of what the constants explain.
    assert drift.alone < 0.5 * only(found).conditional


def test_gains_of_kinds_do_not_hide_a_drift(smooth: Any, make: Make) -> None:
    """Constants and gains of kinds together explain more than a drift; constants alone explain as much."""
    injection = into(make, 9_000)
    kinds = one_kind_after_another(injection)
    rest = smooth.counts(np.zeros((1, 3)), np.zeros((1, 3)))
    gains = np.array([-0.2, 0.15, -0.1, 0.2, -0.2, 0.1, 0.05])[kinds, None]
    clock = np.linspace(-1.0, 1.0, len(kinds))[:, None] * np.resize([25.0, -30.0, 15.0], 21)
    add(injection, gains * (injection.recording.channels - rest) + clock)
    found = names(attributed(smooth, injection.recording, exclude=("temperature",)))
    assert found == ["drift", "covariate:material"]
