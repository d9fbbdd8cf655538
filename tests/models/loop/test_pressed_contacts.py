"""Contacts whose recording begins when the finger is pressed: creeps, loads, steps and delays in them."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.models.loop.inference.tared import Tared, with_counts

from taxel_models.loop.effects.effect import Remaining
from taxel_models.loop.effects.lag import Lag
from taxel_models.loop.observations import gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.report.drivers import axis_of
from taxel_models.loop.report.partial import Partial
from taxel_models.recordings import Recording

Floats = NDArray[np.float64]
Plant = Callable[[Floats, Floats], Floats]

CONTACTS: Final = 30
ROWS: Final = 400
"""Of each contact: 4 s."""


def presses(smooth: Any, plant: Plant, noise: float = 4.0) -> Recording:
    """Contacts whose recording begins when the finger is pressed already, and what is planted in them.

    Args:
        plant: from the forces (contacts, rows), N, and the random weights (21,) to changes, counts.
    """
    random = np.random.default_rng(4)
    seconds = np.arange(ROWS) / 100
    ends, waves = random.uniform(4.0, 9.0, (2, CONTACTS, 1))
    force_n = 2.0 + ends * seconds / 4 + 0.8 * np.sin(waves * seconds)
    direction = np.array([0.1, -0.2, 0.97]) + random.normal(scale=0.1, size=(CONTACTS, 1, 3))
    force = (force_n[:, :, None] * direction / np.linalg.norm(direction, axis=2, keepdims=True)).reshape(
        -1, 3
    )
    start, way = random.normal(scale=2e-3, size=(2, CONTACTS, 1, 3))
    position = (np.array([0.0, 0.0, -0.006]) + start + way * seconds[:, None]).reshape(-1, 3)
    time = (np.arange(CONTACTS)[:, None] * 6.0 + seconds).ravel()
    counts = smooth.counts(position, force) + random.normal(scale=noise, size=(len(time), 21))
    change = plant(force_n, random.normal(scale=12.0, size=21)).reshape(-1, 21)
    channels = np.clip(np.rint(counts + change), 0, 4095)
    auxiliary = {name: np.full(len(time), 2000.0) for name in ("pac1", "tac", "tdc")}
    return Recording.of(np.rint(time * 1e9).astype(np.int64), position, force, channels, auxiliary)


def low_passed(force_n: Floats, tau_s: float, first: Floats) -> Floats:
    """(contacts, rows) through a first-order low-pass that begins at a first value (contacts,)."""
    found, held = np.empty_like(force_n), first
    for row, force in enumerate(force_n.T):
        held = held + (1.0 - np.exp(-0.01 / tau_s)) * (force - held) if row else first
        found[:, row] = held
    return found


def weighted(course: Floats, weights: Floats) -> Floats:
    """(contacts, rows, 21) of a course about its mean, one standard deviation of it times the weights."""
    return ((course - course.mean()) / course.std())[:, :, None] * weights


def named(smooth: Any, plant: Plant) -> list[Any]:
    """Effects, in the loop's order."""
    return list(run_loop(smooth, [presses(smooth, plant)], LoopSettings()).findings.effects)


@pytest.mark.parametrize("start", ["settled", "from rest"])
@pytest.mark.parametrize("ahead", [True, False], ids=["less the force", "the low-pass"])
def test_a_creep_is_found_however_its_contacts_begin(smooth: Any, start: str, ahead: bool) -> None:
    def creep(force_n: Floats, weights: Floats) -> Floats:
        first = np.zeros(CONTACTS) if start == "from rest" else force_n[:, 0]
        return weighted(low_passed(force_n, 1.0, first) - ahead * force_n, weights)

    (effect,) = named(smooth, creep)
    assert effect.name == "creep"
    assert ("from rest" in effect.form, "low-passed" in effect.form) == (start == "from rest", not ahead)
    figures = {figure.name: figure.value for figure in effect.parameters}
    assert figures["time_constant"] == pytest.approx(1.0, rel=0.2)


def test_an_offset_beside_such_a_creep_is_named_too(smooth: Any) -> None:
    def both(force_n: Floats, weights: Floats) -> Floats:
        return weighted(low_passed(force_n, 1.0, np.zeros(CONTACTS)), weights) + weights[::-1]

    assert {effect.name for effect in named(smooth, both)} == {"creep", "offset"}


@pytest.mark.parametrize(
    ("alike", "measured"), [(True, True), pytest.param(True, False, marks=pytest.mark.long), (False, True)]
)
def test_tared_electrodes_that_warm_alike_are_no_creep(smooth: Any, alike: bool, measured: bool) -> None:
    """The skin warms by 1 - exp(-t / 3 s) in each contact, whatever the force is.

    Where electrodes move to both sides, it is a creep.
    """
    tared = Tared(smooth)
    recording = tared.of(presses(smooth, lambda force_n, weights: np.zeros((*force_n.shape, 21))))
    warm = 1.0 - np.exp(-np.arange(ROWS) / 300)
    slopes = 30.0 * (1.0 + 0.2 * np.cos(np.arange(21))) * (np.arange(21) >= 2)
    if not alike:
        slopes[::2] *= -1.0
    change = (warm - warm.mean())[:, None] * slopes
    recording = with_counts(recording, recording.channels + np.tile(change, (CONTACTS, 1)))
    wander = np.cumsum(np.random.default_rng(2).normal(size=len(recording)))
    warmed = replace(recording, auxiliary={**recording.auxiliary, "tdc": 2000.0 + wander})
    settings = LoopSettings(withheld=() if measured else ("tdc",))
    result = run_loop(tared, [warmed], settings)
    assert [effect.name for effect in result.findings.effects] == (["temperature"] if alike else ["creep"])
    # Its picture is drawn over what it is in proportion to, not over the temperature of the core.
    partial = Partial.of(result, result.attribution.named[0])
    channel = partial.channels[0]
    axis = axis_of(result, partial, channel)
    assert ("how warm" in axis.label) == alike
    assert abs(np.corrcoef(axis.values, partial.contribution[:, channel])[0, 1]) > 0.999


def test_a_response_to_the_force_itself_is_no_memory(smooth: Any) -> None:
    (effect,) = named(smooth, weighted)
    assert effect.name == "load"


@pytest.mark.parametrize("share", [0.31, 0.7])
def test_a_step_is_a_drift_that_tells_when(smooth: Any, share: float) -> None:
    def step(force_n: Floats, weights: Floats) -> Floats:
        late = np.arange(CONTACTS) >= share * CONTACTS
        return late[:, None, None] * np.broadcast_to(weights, (CONTACTS, ROWS, 21))

    # Blocks that are held out say nothing: a step in two contacts of these may lie anywhere there.
    first = next(effect for effect in named(smooth, step) if effect.name != "offset")
    assert first.name == "drift"
    told = re.match(r"a step at ([\d.]+) s", first.form)
    assert told is not None
    assert float(told[1]) == pytest.approx(np.ceil(share * CONTACTS) * 6.0, abs=13.0)


class Jumping:
    """A model whose predictions jump from row to row, as a forest's do."""

    def __init__(self, smooth: Any) -> None:
        self._smooth, self.manifest = smooth, smooth.manifest

    def predict_base(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The same as `predict`."""
        return self.predict(windows)

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """In steps of 60 counts."""
        return np.rint(self._smooth.predict(windows) / 60.0) * 60.0


@pytest.mark.parametrize(("ticks", "near"), [(1.5, 2), (2, 2), (4, 3), (10, 11)])
def test_single_rows_tell_a_delay(smooth: Any, ticks: float, near: int) -> None:
    """Means of several rows, which the evidence is of, may tell a delay nearby."""

    def nothing(force_n: Floats, weights: Floats) -> Floats:
        return 0.0 * force_n[:, :, None] * weights

    observations = gather(Jumping(smooth), [presses(smooth, nothing)])
    around = (int(np.floor(ticks)), int(np.ceil(ticks)))
    late = [observations.measured[observations.rows_before(part)] for part in around]
    residual, every = np.mean(late, axis=0) - observations.predicted, np.ones(len(observations), bool)
    lag = Lag()
    forms = lag.forms(observations, Remaining(residual, every, np.ones(len(every))))
    likeliest = next(form for form in forms if form.form == f"{near * 10} ms")
    assert lag.by_rows(observations, likeliest, residual, every).form == f"{ticks * 10:g} ms"
