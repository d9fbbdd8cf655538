"""Finds inputs that are probably wrong, though every number is finite: units, signs, frames, rates.

A model answers any numbers with plausible channels. So what comes in is compared with the contacts that the
model was trained on (`taxel.trained_contacts`). What looks wrong is told once, by name, as a
`taxel.errors.InputWarning`; where the caller is strict, it is an error.
"""

import sys
import warnings
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taxel.errors import InputWarning, InvalidArgument
from taxel.skin import Fingertip, off_axis
from taxel.trained_contacts import OFF_SKIN_M, TOUCHED_N, Range, TrainedContacts, outward

MARGIN: Final = 0.25
"""Values may leave the training's range by this share of its width."""

FORCE_UNITS: Final = {"grams": 9.80665e-3, "millinewtons": 1e-3}
"""Other units of force, in N."""

_OTHER_UNIT: Final = 3.0
"""From so many times the training's largest force on, another unit is likelier than a stronger push."""

_LEAST_TOUCHES: Final = 20
"""From so many touches on, the sign of the force is judged."""

_PULL: Final = 0.2
"""The share of the summed forces that may point the wrong way; friction lies along the skin."""

_NEARLY_ALL: Final = 0.9
"""If fewer of the training's touches lie on the skin, or press, its frame is another one."""

_SLOWER: Final = 2.5
"""Samples that come this much more slowly than in training are too slow."""

_RATE_TOLERANCE: Final = 0.15
"""How far the median interval may be from the one that was told."""

_MOST_ROWS, _MOST_STEPS = 4096, 100
"""About so many samples, and of at most so many steps, are kept until they are looked at together."""


class Finding(NamedTuple):
    """Something that looks wrong: its name, and what was seen and what was expected."""

    name: str
    text: str


def contact_findings(
    trained: TrainedContacts, position: NDArray[np.float64], force: NDArray[np.float64]
) -> list[Finding]:
    """What looks wrong in samples (n, 3), m, and (n, 3), N, n above 0, beside those of a training."""
    magnitude = np.sqrt(np.einsum("ij,ij->i", force, force))
    found = _force_findings(trained, force, float(magnitude.max()))
    newtons = FORCE_UNITS.get(found[0].name, 1.0) if found else 1.0
    touched = magnitude * newtons >= TOUCHED_N
    if touched.any():
        places = position[touched]
        found += _place_findings(trained, places)
        if all(finding.name != "off the skin" for finding in found):
            found += _sign_findings(trained, places, force[touched], float(magnitude[touched].sum()))
    return found


def _force_findings(trained: TrainedContacts, force: NDArray[np.float64], largest: float) -> list[Finding]:
    known = trained.force.high
    most = (1.0 + MARGIN) * known
    if largest > _OTHER_UNIT * known:
        for unit, newtons in FORCE_UNITS.items():
            if largest * newtons <= most:
                return [
                    Finding(
                        unit,
                        f"forces up to {largest:.4g} look like {unit}: expected newtons, up to {known:.3g}",
                    )
                ]
    if largest > most:
        return [_outside("force", largest, trained.force, "N")]
    for name, column in zip(("fx", "fy", "fz"), force.T, strict=True):
        axis: Range = getattr(trained, name)
        for value in (float(column.min()), float(column.max())):
            if not axis.low - MARGIN * known <= value <= axis.high + MARGIN * known:
                return [_outside(name, value, axis, "N")]
    return []


def _place_findings(trained: TrainedContacts, places: NDArray[np.float64]) -> list[Finding]:
    strange = _strange(trained, places)
    count = int(np.count_nonzero(strange))
    if not count:
        return []
    many = f"{count:,} of {len(places):,} touched places"
    places = places[strange]
    if np.mean(_strange(trained, places / 1e3)) < 0.5:
        reach = float(np.abs(places).max())
        return [Finding("millimetres", f"{many} look like millimetres, as {reach:.4g}: expected metres")]
    if trained.on_skin >= _NEARLY_ALL:
        heights = Fingertip.biotac_2p().height(places)
        farthest = float(heights[np.argmax(np.abs(heights))])
        if abs(farthest) > OFF_SKIN_M:
            where = f"{abs(farthest) * 1e3:.3g} mm {'outside' if farthest > 0.0 else 'inside'} it"
            return [
                Finding(
                    "off the skin",
                    f"{many} are off the skin, one of them {where}: expected places on taxel.skin, in the "
                    "sensor's frame",
                )
            ]
    for name, column in zip("xyz", places.T, strict=True):
        axis: Range = getattr(trained, name)
        for value in (float(column.min()), float(column.max())):
            if not axis.low - _slack(axis) <= value <= axis.high + _slack(axis):
                return [_outside(name, value, axis, "m")]
    return []


def _strange(trained: TrainedContacts, places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which places (n, 3) are outside the training's ranges, or off the skin if the training was on it."""
    columns = np.ascontiguousarray(places.T)
    strange = np.zeros(len(places), np.bool_)
    for column, axis in zip(columns, (trained.x, trained.y, trained.z), strict=True):
        strange |= (column < axis.low - _slack(axis)) | (column > axis.high + _slack(axis))
    if trained.on_skin >= _NEARLY_ALL:
        # As Fingertip.height, at half the cost.
        away = off_axis(places)
        distance = np.sqrt(np.einsum("ij,ij->i", away, away))
        strange |= np.abs(distance - Fingertip.biotac_2p().radius) > OFF_SKIN_M
    return strange


def _slack(axis: Range) -> float:
    return max(MARGIN * axis.width, OFF_SKIN_M)


def _sign_findings(
    trained: TrainedContacts, places: NDArray[np.float64], force: NDArray[np.float64], summed: float
) -> list[Finding]:
    """The sign is that of the training: a rig may have recorded what the finger does to the other."""
    if len(places) < _LEAST_TOUCHES or 1.0 - _NEARLY_ALL < trained.pressing < _NEARLY_ALL:
        return []
    pull = float(outward(places, force).sum()) / summed
    if trained.pressing < 0.5:
        pull = -pull
    if pull <= _PULL:
        return []
    wrong = (
        "pull at the skin: expected the force on the finger, which presses"
        if trained.pressing >= 0.5
        else "press on the skin: expected the opposite sign, as in training"
    )
    return [Finding("wrong sign", f"the forces of {len(places):,} samples in touch {wrong}")]


def extra_findings(trained: TrainedContacts, name: str, values: NDArray[Any]) -> list[Finding]:
    """What looks wrong in an extra feature, (n,)."""
    known = trained.extras.get(name)
    if known is None:
        return []
    for value in (float(values.min()), float(values.max())):
        if not known.low - MARGIN * known.width <= value <= known.high + MARGIN * known.width:
            return [_outside(name, value, known, "counts")]
    return []


def _outside(name: str, value: float, known: Range, unit: str) -> Finding:
    return Finding(
        f"{name} out of range",
        f"{name} of {value:.4g} {unit}: expected {known.low:.4g} to {known.high:.4g} {unit}",
    )


def rate_findings(trained: TrainedContacts, period_s: float) -> list[Finding]:
    """What looks wrong in the interval between samples, s."""
    known = trained.period_ms / 1e3
    if period_s <= _SLOWER * known:
        return []
    return [
        Finding(
            "rate",
            f"a sample every {period_s * 1e3:.4g} ms: expected one every {known * 1e3:.4g} ms or so",
        )
    ]


def interval_findings(seconds: float, told_s: float, *, ticks: bool) -> list[Finding]:
    """What looks wrong in the median time between steps, beside the interval that was told, s.

    Args:
        ticks: whether each sample is taken as a tick, so that the interval has to be right.
    """
    longest = max(0.05, _SLOWER * told_s)
    if seconds > longest:
        looks = "looks like milliseconds" if seconds / 1e3 <= longest else "is a gap after each sample"
        return [Finding("rate", f"dt of {seconds:.4g} s {looks}: expected about {told_s:.4g} s")]
    if ticks and abs(seconds - told_s) > _RATE_TOLERANCE * told_s:
        return [
            Finding(
                "rate",
                f"dt is {seconds:.4g} s, but rate_hz says {told_s:.4g} s: give rate_hz={1 / seconds:.4g}",
            )
        ]
    return []


class InputCheck:
    """Looks at what comes into a stream: at first often, later every 100 steps or 4096 samples.

    If it is strict, it looks at each sample before that is used.

    Args:
        label: the model's name, for the text.
        trained: what it was trained on.
        period_s: the interval at which samples are to come, s.
        ticks: whether each sample is taken as a tick.
        strict: whether a finding is an error.

    Raises:
        InvalidArgument: it is strict, and samples are to come too slowly.
    """

    def __init__(
        self,
        label: str,
        trained: TrainedContacts,
        period_s: float,
        *,
        ticks: bool,
        strict: bool,
    ) -> None:
        self._label, self._trained, self._strict = label, trained, strict
        self._period_s, self._ticks = period_s, ticks
        self._told: set[str] = set()
        self._of_contacts: dict[str, str] = {}
        self._of_others: dict[str, str] = {}
        self._position = np.empty((0, 3))
        self._force = np.empty((0, 3))
        self._held = 0
        self._due = self._most = 1
        self.tell(rate_findings(trained, period_s))

    def take(
        self,
        position: NDArray[Any],
        force: NDArray[Any],
        seconds: ArrayLike | None = None,
    ) -> None:
        """Take finite samples (k, 3), m, and (k, 3), N, always the same k; `seconds` since the last ones.

        They are of any real type, and are written down as float64 until they are looked at.

        Raises:
            InvalidArgument: it is strict, and something looks wrong.
        """
        count = len(position)
        if not len(self._position):
            self._most = min(_MOST_ROWS, _MOST_STEPS * count)
            self._position = np.empty((self._most + count, 3))
            self._force = np.empty((self._most + count, 3))
        stop = self._held + count
        self._position[self._held : stop] = position
        self._force[self._held : stop] = force
        self._held = stop
        due = stop >= self._due
        if due:
            self._held, self._due = 0, min(2 * self._due, self._most)
        if due or self._strict:
            try:
                self._look(self._position[:stop], self._force[:stop])
            except InvalidArgument:
                # What is refused must not stand against later samples.
                self._held = 0
                raise
        if due and seconds is not None:
            median = float(np.median(np.asarray(seconds, np.float64)))
            self.tell(interval_findings(median, self._period_s, ticks=self._ticks))

    @property
    def standing(self) -> list[str]:
        """What looks wrong, as it was seen last.

        What was seen in contacts stands until some 20 touches are looked at that do not have it.
        """
        return [*self._of_others.values(), *self._of_contacts.values()]

    def look(self, position: NDArray[Any], force: NDArray[Any]) -> None:
        """Look now at finite samples of any number, which `take` does not get; raises as `take`."""
        if len(position):
            self._look(np.asarray(position, np.float64), np.asarray(force, np.float64))

    def _look(self, position: NDArray[np.float64], force: NDArray[np.float64]) -> None:
        found = contact_findings(self._trained, position, force)
        if self._of_contacts:
            touches = np.count_nonzero(np.einsum("ij,ij->i", force, force) >= TOUCHED_N**2)
            if touches >= _LEAST_TOUCHES:
                self._of_contacts.clear()
        self._tell(found)
        self._of_contacts |= {name: f"{self._label}: {text}" for name, text in found}

    def extra(self, name: str, values: NDArray[Any]) -> None:
        """Take the values of an extra feature, (k,); raises as `take`."""
        self.tell(extra_findings(self._trained, name, values))

    def tell(self, findings: Iterable[Finding]) -> None:
        """Warn of what was not told before, and does not lie in contacts; or raise, if strict."""
        found = list(findings)
        self._tell(found)
        self._of_others |= {name: f"{self._label}: {text}" for name, text in found}

    def _tell(self, findings: Iterable[Finding]) -> None:
        for name, text in findings:
            if self._strict:
                raise InvalidArgument(f"{self._label}: {text}")
            if name not in self._told:
                self._told.add(name)
                warn(f"{self._label}: {text}")


def warn(text: str) -> None:
    """Warn of an input, with the line of the caller outside of Taxel."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(("taxel.", "taxel_")):
        level, frame = level + 1, frame.f_back
    warnings.warn(text, InputWarning, stacklevel=level)
