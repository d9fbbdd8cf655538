"""The fingertips of a ROS 2 node, whatever carries its messages."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.errors import InvalidArgument, RequestError
from taxel.predictor import Predictor
from taxel.ros2.finger_input import REPORTED_S, ContactMessage, FingerInput, Sample
from taxel.ros2.messages import Level, Status
from taxel.ros2.settings import NodeSettings
from taxel.windows import WindowStream
from taxel.windows.samples import gap_of


class Prediction(NamedTuple):
    """The channels of one finger.

    Attributes:
        finger: its name.
        stamp_ns: the time that they describe.
        channels: (21,) float32, counts.
    """

    finger: str
    stamp_ns: int
    channels: NDArray[np.float32]


class HandFrame(NamedTuple):
    """The channels of all fingers, once in a period.

    Attributes:
        stamp_ns: the latest time that they describe.
        channels: (21,) counts by finger; stale fingers are left out.
    """

    stamp_ns: int
    channels: Mapping[str, NDArray[np.float32]]


class Output(NamedTuple):
    """What is to be published after a message was taken."""

    predictions: list[Prediction]
    hand: list[HandFrame]


class TactileNode:
    """Takes messages of contacts and gives what a node publishes. It knows no transport.

    A hand frame is complete once every finger that is not stale has a new prediction. If a finger has
    another one before that, the frame is given as it is.

    Args:
        predictor: predicts the channels.
        settings: the fingers.

    Raises:
        InvalidArgument: the settings are strict, and contacts are to come too slowly for the model.
    """

    def __init__(self, predictor: Predictor, settings: NodeSettings) -> None:
        self.settings = settings
        self._predictor = predictor
        self._inputs = {finger: self._input(finger) for finger in settings.fingers}
        # Without a check: samples lie on the skin, wherever their contacts were.
        extras = predictor.manifest.window.extras
        self._streams = {
            finger: WindowStream(predictor.window, rate_hz=settings.rate_hz, extras=extras)
            for finger in settings.fingers
        }
        self._last_ns = dict.fromkeys(settings.fingers, 0)
        self._gap_ns = gap_of(round(1e9 / settings.rate_hz))
        self._frame: dict[str, Prediction] = {}
        self._newest: dict[str, Prediction] = {}
        self._predicted = 0
        self._failure: tuple[str, float] | None = None

    def _input(self, finger: str) -> FingerInput:
        check = self._predictor.input_check(
            self.settings.rate_hz,
            strict=self.settings.strict,
            of=f"finger {finger}, ",
        )
        return FingerInput(finger, self.settings, check)

    def take(self, finger: str, message: ContactMessage, now_s: float) -> Output:
        """Take a message of one finger that came at `now_s`, s of a clock that never goes back.

        Raises:
            InvalidArgument: the settings are strict, and the contact looks wrong, or contacts come at
                another rate. The finger's status says so, too.
        """
        sample = self._inputs[finger].take(message, now_s)
        predictions = [] if sample is None else self._predict(finger, sample, now_s)
        hand: list[HandFrame] = []
        for prediction in predictions:
            if finger in self._frame:
                hand.append(self._hand(now_s))
            self._frame[finger] = self._newest[finger] = prediction
            if all(one in self._frame or self._inputs[one].is_stale(now_s) for one in self._inputs):
                hand.append(self._hand(now_s))
        return Output(predictions, hand)

    def refuse(self, finger: str, reason: str, now_s: float) -> None:
        """Count a message of a finger that could not even be read."""
        self._inputs[finger].refuse(reason, now_s)

    def report(self, finger: str, text: str, now_s: float) -> None:
        """Report what is wrong with what a finger's topics carry."""
        self._inputs[finger].report("topic", Level.ERROR, text, now_s)

    def statuses(self, now_s: float, dropped: int = 0) -> list[Status]:
        """How well the predictor and each finger are.

        Args:
            now_s: now, s.
            dropped: how many messages were dropped because the predictor is too slow for them.
        """
        manifest = self._predictor.manifest
        level, text = Level.OK, "predicts"
        if dropped:
            level, text = Level.WARN, f"{dropped} messages dropped: contacts come faster than predictions"
        if self._failure is not None and now_s - self._failure[1] <= REPORTED_S:
            level, text = Level.ERROR, self._failure[0]
        own = Status(
            "taxel: predictor",
            level,
            text,
            {
                "model": manifest.label,
                "predictions": str(self._predicted),
                "delay_ms": f"{self._predictor.window.delay_s * 1e3:g}",
            },
        )
        return [own, *(one.status(now_s) for one in self._inputs.values())]

    def _predict(self, finger: str, sample: Sample, now_s: float) -> list[Prediction]:
        own, stream = self._inputs[finger], self._streams[finger]
        behind_ns = self._last_ns[finger] - sample.stamp_ns
        if behind_ns > self._gap_ns:
            stream.reset()
            self._newest.pop(finger, None)
            own.report("time", Level.WARN, f"time went back by {behind_ns / 1e9:g} s: begun again", now_s)
        try:
            windows = stream.push_ns(sample.stamp_ns, sample.position, sample.force)
        except InvalidArgument as error:
            own.refuse(str(error), now_s)
            # Time that stands still makes no channels; contacts at another rate make wrong ones.
            if self.settings.strict and behind_ns < 0:
                raise InvalidArgument(f"finger {finger}: {error}") from None
            return []
        self._last_ns[finger] = sample.stamp_ns
        if not windows:
            return []
        try:
            channels = self._predictor.predict(np.concatenate([window.values for window in windows]))
        except RequestError as error:
            self._failure = (str(error), now_s)
            return []
        self._predicted += len(channels)
        return [
            Prediction(finger, window.time_ns, row) for window, row in zip(windows, channels, strict=True)
        ]

    def _hand(self, now_s: float) -> HandFrame:
        """The frame as it is now, and begin the next one."""
        stamp_ns = max(prediction.stamp_ns for prediction in self._frame.values())
        self._frame = {}
        return HandFrame(
            stamp_ns,
            {
                finger: prediction.channels
                for finger, prediction in self._newest.items()
                if not self._inputs[finger].is_stale(now_s)
            },
        )
