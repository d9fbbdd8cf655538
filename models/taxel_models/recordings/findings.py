"""What looks wrong in a recording: units, signs, places, the clock, glitches, channels that stand still."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.errors import RecordingError
from taxel.input_checks import FORCE_UNITS, Finding, contact_findings, rate_findings, warn
from taxel.skin import Fingertip
from taxel.trained_contacts import TOUCHED_N, Range, TrainedContacts
from taxel_models.recordings.glitches import jumps
from taxel_models.recordings.recording import Recording

_RADIUS: Final = Fingertip.biotac_2p().radius
_PUSH_N: Final = 20.0

PLAUSIBLE: Final = TrainedContacts(
    period_ms=10.0,
    x=Range(low=-0.025, high=_RADIUS),
    y=Range(low=-_RADIUS, high=_RADIUS),
    z=Range(low=-_RADIUS, high=_RADIUS),
    fx=Range(low=-_PUSH_N, high=_PUSH_N),
    fy=Range(low=-_PUSH_N, high=_PUSH_N),
    fz=Range(low=-_PUSH_N, high=_PUSH_N),
    force=Range(low=0.0, high=_PUSH_N),
    on_skin=1.0,
    pressing=1.0,
)
"""Contacts of any fingertip in the sensor's frame, for recordings that no model is asked about. More than
20 N would harm the skin."""

_REACH: Final = Range(low=-3.0, high=3.0)

IN_A_ROBOTS_FRAME: Final = PLAUSIBLE.model_copy(
    update={"x": _REACH, "y": _REACH, "z": _REACH, "on_skin": 0.0, "pressing": 0.5}
)
"""Contacts in the frame of a robot's base, in which the skin and the sign of a press are not known."""

_TIME_UNITS: Final = {"milliseconds": 1e6, "microseconds": 1e3}
"""Other units of time, in ns."""

_OTHER_UNITS: Final = frozenset({"millimetres", *FORCE_UNITS})

_USUAL: Final = 0.9
"""The share of the samples in touch that tells the unit, without the strongest and farthest."""

_FASTEST_NS, _SLOWEST_NS = 2e5, 2e8
"""Intervals between samples of any sensor or simulator, ns."""

_LEAST_ROWS: Final = 100
"""In fewer rows, a channel may stand still."""

_LEAST_VALUES: Final = 5
"""A channel with fewer different values may have the same step between them by chance."""

_STILL_COUNTS: Final = 2.0
"""A channel hardly moves if all but 2 % of its rows lie within so many counts."""


def recording_findings(recording: Recording, trained: TrainedContacts | None = None) -> list[Finding]:
    """What looks wrong in a recording; nothing in one without rows.

    Args:
        trained: the contacts of a model that is to predict it; if none, those of any fingertip, which in
            slide recordings are in the robot's frame.
    """
    if not len(recording):
        return []
    known = trained or _plausible(recording)
    samples = recording.samples
    found = _time_findings(recording, known)
    found += contact_findings(known, samples.position, samples.force)
    largest = float(np.linalg.norm(samples.force, axis=1).max())
    if len(recording) >= _LEAST_ROWS and largest < TOUCHED_N:
        text = (
            f"no force is above {largest:.3g} N: expected touches of {TOUCHED_N:g} N and more, in newtons"
        )
        found.append(Finding("no touch", text))
    return [*found, *_channel_findings(recording)]


def check_recording(
    recording: Recording, trained: TrainedContacts | None = None, *, strict: bool = False
) -> None:
    """Warn of what looks wrong, each by an `InputWarning`.

    Raises:
        RecordingError: something looks wrong, and `strict` says that it is an error.
    """
    texts = [text for _, text in recording_findings(recording, trained)]
    if strict and texts:
        raise RecordingError(f"{recording.name}: {'; '.join(texts)}")
    for text in texts:
        warn(f"{recording.name}: {text}")


def check_units(recording: Recording, trained: TrainedContacts | None) -> None:
    """Check that places are in metres and forces in newtons; single samples may be wrong.

    Args:
        trained: as of `recording_findings`.

    Raises:
        RecordingError: most samples in touch look like another unit.
    """
    samples = recording.samples
    force, place = (np.linalg.norm(values, axis=1) for values in (samples.force, samples.position))
    usual = force >= TOUCHED_N
    if not usual.any():
        return
    usual &= (force <= np.quantile(force[usual], _USUAL)) & (place <= np.quantile(place[usual], _USUAL))
    known = trained or _plausible(recording)
    for unit, _ in contact_findings(known, samples.position[usual], samples.force[usual]):
        if unit in _OTHER_UNITS:
            what = "places are in millimetres: expected metres"
            if unit in FORCE_UNITS:
                what = f"forces are in {unit}: expected newtons"
            raise RecordingError(f"{recording.name}: most {what}, as the model takes them")


def _plausible(recording: Recording) -> TrainedContacts:
    return IN_A_ROBOTS_FRAME if recording.format == "biotac_slide" else PLAUSIBLE


def _time_findings(recording: Recording, trained: TrainedContacts) -> list[Finding]:
    if len(recording) < 2:
        return []
    period = float(np.median(np.diff(recording.samples.time_ns)))
    if period < _FASTEST_NS:
        for unit, nanoseconds in _TIME_UNITS.items():
            if _FASTEST_NS <= period * nanoseconds <= _SLOWEST_NS:
                text = f"times that grow by {period:g} look like {unit}: expected nanoseconds"
                return [Finding(unit, text)]
        return [Finding("rate", f"a sample every {period:g} ns: expected one every 10 ms or so")]
    return rate_findings(trained, period / 1e9)


def _channel_findings(recording: Recording) -> list[Finding]:
    channels = recording.channels
    found = []
    low, high = float(channels.min()), float(channels.max())
    if low < 0.0 or high > COUNTS_MAX:
        found.append(
            Finding("counts", f"channels from {low:g} to {high:g}: expected counts from 0 to {COUNTS_MAX}")
        )
    glitches = np.concatenate([jumps(channels[segment]) for segment in recording.segments])
    if rows := np.count_nonzero(glitches.any(axis=1)):
        where = _named(np.asarray(glitches.any(axis=0)))
        found.append(Finding("glitches", f"{rows:,} rows jump far away and back, in {where}"))
    if len(recording) >= _LEAST_ROWS:
        constant = channels.min(axis=0) == channels.max(axis=0)
        if constant.any():
            found.append(Finding("constant channels", f"the same value in all rows in {_named(constant)}"))
        ends = np.quantile(channels, [0.01, 0.99], axis=0)
        still = (ends[1] - ends[0] <= _STILL_COUNTS) & ~constant
        if still.any():
            found.append(
                Finding(
                    "still channels", f"98 % of the rows within {_STILL_COUNTS:g} counts in {_named(still)}"
                )
            )
        steps = np.array([_step(channel) for channel in channels.T])
        if (steps > 1).any():
            which = ", ".join(map(str, sorted(set(steps[steps > 1].tolist()))))
            where = _named(steps > 1)
            text = f"steps of {which} counts in {where}: expected steps of 1; lower bits may be lost"
            found.append(Finding("coarse counts", text))
    return found


def _step(counts: NDArray[np.float64]) -> int:
    """The step that whole counts (n,) have in common; 1 where they are not whole, or take few values."""
    if (counts != np.rint(counts)).any():
        return 1
    step = int(np.gcd.reduce((counts - counts.min()).astype(np.int64)))
    # Sorting takes far longer, and nearly all channels have a step of 1.
    return step if step > 1 and len(np.unique(counts)) >= _LEAST_VALUES else 1


def _named(chosen: NDArray[np.bool_]) -> str:
    return ", ".join(name for name, taken in zip(CHANNELS, chosen, strict=True) if taken)
