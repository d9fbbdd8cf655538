"""One finger of a node: from its messages to samples, and whether they are as they should be."""

from collections import deque
from math import isfinite
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.errors import InvalidArgument
from taxel.input_checks import InputCheck
from taxel.ros2.messages import Level, Status
from taxel.ros2.settings import Inputs, NodeSettings
from taxel.skin import PAD, Fingertip
from taxel.trained_contacts import OFF_SKIN_M

RATE_TOLERANCE: Final = 0.15
"""How far the mean rate of contacts may be off."""

WAITING_WRENCHES: Final = 10
"""So many wrenches wait for their points, and points for their wrenches."""

REPORTED_S: Final = 1.0
"""A fault is reported for so long after it was last seen, and at least once."""

Vector = tuple[float, float, float]


class ContactMessage(NamedTuple):
    """What a message says of a contact: either of the two, or both.

    Attributes:
        stamp_ns: the time in its header.
        frame_id: the frame in its header.
        place: where the finger is touched, m.
        force: on the finger, N.
    """

    stamp_ns: int
    frame_id: str
    place: Vector | None
    force: Vector | None


class Sample(NamedTuple):
    """One contact of a finger, as models take it.

    Attributes:
        stamp_ns: its time.
        position: (3,), on the skin, m, in the sensor's frame.
        force: (3,), on the finger, N.
    """

    stamp_ns: int
    position: NDArray[np.float64]
    force: NDArray[np.float64]


class _Fault(NamedTuple):
    """What was wrong, and when it was seen last, s."""

    level: Level
    text: str
    seen_s: float


class FingerInput:
    """Makes samples of one finger's messages.

    A wrench and a point make a sample if their stamps differ by no more than `pair_within_s`. A wrench
    without force needs no point: nothing touches, and the place stays.

    Args:
        finger: its name.
        settings: of the node.
        check: looks at contacts as they come, before they are moved to the skin.

    Attributes:
        samples: how many samples there were.
        refused: how many messages were not used.
        last_s: when the last sample came, s of the clock that `take` is given; None if none has come.
    """

    def __init__(self, finger: str, settings: NodeSettings, check: InputCheck | None = None) -> None:
        self.finger = finger
        self._check = check
        self._settings = settings
        self._frame = settings.frame_of(finger)
        self._within_ns = round(settings.pair_within_s * 1e9)
        self._points: deque[ContactMessage] = deque(maxlen=WAITING_WRENCHES + 1)
        self._wrenches: deque[ContactMessage] = deque()
        self._place: NDArray[np.float64] = np.array(PAD)
        self._faults: dict[str, _Fault] = {}
        self._told: set[str] = set()
        self._interval_ns = 0.0
        self._previous_ns: int | None = None
        self.samples = self.refused = 0
        self.last_s: float | None = None

    def take(self, message: ContactMessage, now_s: float) -> Sample | None:
        """Take a message that came at `now_s`; gives a sample if it completes one.

        Raises:
            InvalidArgument: the settings are strict, and the contact looks wrong.
        """
        try:
            contact = self._paired(self._checked(message), now_s)
        except InvalidArgument as error:
            self.refuse(str(error), now_s)
            return None
        if contact is None:
            return None
        try:
            sample = self._sample(contact, now_s)
        except InvalidArgument as error:
            self.refuse(str(error), now_s)
            raise
        self._measure(sample.stamp_ns)
        self.samples += 1
        self.last_s = now_s
        return sample

    def _measure(self, stamp_ns: int) -> None:
        """Follow the mean interval, over some 20 of them; silence is none."""
        interval = stamp_ns - (stamp_ns if self._previous_ns is None else self._previous_ns)
        if 0 < interval <= self._settings.stale_after_s * 1e9:
            self._interval_ns += (interval - self._interval_ns) * (0.05 if self._interval_ns else 1.0)
        self._previous_ns = stamp_ns

    def refuse(self, reason: str, now_s: float) -> None:
        """Count a message that cannot be used."""
        self.refused += 1
        self.report("refused", Level.ERROR, reason, now_s)

    def report(self, kind: str, level: Level, text: str, now_s: float) -> None:
        """Report a fault; a later one of the same kind replaces it."""
        self._faults[kind] = _Fault(level, text, now_s)
        self._told.discard(kind)

    def status(self, now_s: float) -> Status:
        """How well this finger's input is."""
        faults = [
            fault
            for kind, fault in self._faults.items()
            if kind not in self._told or now_s - fault.seen_s <= REPORTED_S
        ]
        self._told = set(self._faults)
        standing = [] if self._check is None else self._check.standing
        faults += [_Fault(Level.WARN, text, now_s) for text in standing]
        if self.is_stale(now_s):
            silent = (
                "no contact yet" if self.last_s is None else f"no contact for {now_s - self.last_s:.1f} s"
            )
            faults.append(
                _Fault(Level.STALE, f"{silent}: expected {self._settings.rate_hz:g} a second", now_s)
            )
        rate = 1e9 / self._interval_ns if self._interval_ns else 0.0
        wanted = self._settings.rate_hz
        if rate and abs(rate - wanted) > RATE_TOLERANCE * wanted:
            text = f"contacts come at {rate:.1f} Hz: expected {wanted:g} (the parameter rate_hz)"
            faults.append(_Fault(Level.WARN, text, now_s))
        worst = max(faults, key=lambda fault: (fault.level is Level.ERROR, fault.level), default=None)
        return Status(
            f"taxel: {self.finger}",
            Level.OK if worst is None else worst.level,
            "; ".join(fault.text for fault in faults) or "contacts come as expected",
            {
                "rate_hz": f"{rate:.1f}",
                "samples": str(self.samples),
                "refused": str(self.refused),
                "frame_id": self._frame,
            },
        )

    def is_stale(self, now_s: float) -> bool:
        """Whether no sample has come for long."""
        return self.last_s is None or now_s - self.last_s > self._settings.stale_after_s

    def _checked(self, message: ContactMessage) -> ContactMessage:
        """This message, if it can be used.

        Raises:
            InvalidArgument: its frame is another one, it has no time, or a number is not finite.
        """
        if message.frame_id != self._frame:
            raise InvalidArgument(
                f"a message in frame {message.frame_id!r}: expected {self._frame!r}, the sensor's frame "
                "(the parameter frame_id names it; turn contacts into it with tf2)"
            )
        if message.stamp_ns <= 0:
            raise InvalidArgument("a message without a time in its header: expected its stamp")
        for name, value in (("place", message.place), ("force", message.force)):
            if value is not None and not all(map(isfinite, value)):
                raise InvalidArgument(f"{name} {value}: expected finite numbers")
        return message

    def _paired(self, message: ContactMessage, now_s: float) -> ContactMessage | None:
        """A message with both place and force, if there is one now."""
        if self._settings.inputs is Inputs.TACTILE_CONTACT or (message.force and not any(message.force)):
            self._wrenches.clear()
            return message
        # The two topics may run ahead of each other by some messages.
        (self._points if message.force is None else self._wrenches).append(message)
        for wrench in self._wrenches:
            near = [one for one in self._points if abs(one.stamp_ns - wrench.stamp_ns) <= self._within_ns]
            if near:
                while self._wrenches.popleft() is not wrench:
                    self._refuse_wrench(now_s)
                point = min(near, key=lambda one: abs(one.stamp_ns - wrench.stamp_ns))
                return wrench._replace(place=point.place)
        if len(self._wrenches) > WAITING_WRENCHES:
            self._wrenches.popleft()
            self._refuse_wrench(now_s)
        return None

    def _refuse_wrench(self, now_s: float) -> None:
        self.refuse(
            f"a wrench without a point within {self._settings.pair_within_s * 1e3:g} ms of it: "
            "expected both at one rate, or a larger pair_within_s",
            now_s,
        )

    def _sample(self, contact: ContactMessage, now_s: float) -> Sample:
        """The sample, on the skin, as `taxel.contacts` makes it of one contact."""
        force = np.array(contact.force, np.float64)
        if contact.place is not None and force.any():
            skin, places = Fingertip.biotac_2p(), np.array([contact.place], np.float64)
            if self._check is not None:
                self._check.take(places, force[None])
            self._place, height = skin.nearest(places)[0], float(skin.height(places)[0])
            if abs(height) > OFF_SKIN_M:
                text = (
                    f"a contact {height * 1e3:.4g} mm from the skin: expected metres, in the sensor's frame"
                )
                if self._settings.strict:
                    raise InvalidArgument(f"finger {self.finger}: {text}")
                self.report("height", Level.WARN, text, now_s)
        return Sample(contact.stamp_ns, self._place, force)
