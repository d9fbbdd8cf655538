"""The bridge over zenoh, as Gazebo's own transport speaks with `GZ_TRANSPORT_IMPLEMENTATION=zenoh`.

Not run with Gazebo itself: it is written from Gazebo's sources, and tested with a program of its own that
speaks as they do.
"""

import math
import queue
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple, Self

import zenoh
from zenoh.handlers import Callback

from taxel.endpoints import reason_of
from taxel.errors import Unavailable
from taxel.gazebo.gz_transport import GazeboNode, own_partition, zenoh_config
from taxel.gazebo.messages import CHANNELS, CLOCK, CONTACTS, POSES, channel_payload
from taxel.gazebo.settings import BridgeSettings
from taxel.gazebo.tactile_bridge import Prediction, TactileBridge
from taxel.input_checks import warn
from taxel.predictor import Predictor
from taxel.zenoh_process import SIGNAL_CHECK_S, close_session, open_session

_WAITING_MESSAGES: Final = 10_000
"""Messages that wait for the predictor; further ones are dropped, and counted."""

_SILENCE_S: Final = 5.0
"""After so long without a clock, what must fit is told."""


class _Input(NamedTuple):
    """A topic that is subscribed: the type of its messages, and what takes them."""

    topic: str
    type: str
    take: Callable[[bytes], Prediction | None]


class _Arrived(NamedTuple):
    source: _Input
    type: str
    payload: bytes


class ZenohBridge:
    """Fingertips for a world in Gazebo.

    Args:
        predictor: predicts the channels.
        settings: the fingers.
        partition: of Gazebo's transport; `GZ_PARTITION`, or HOST:USER, if None.
        router: a zenoh router, or a Gazebo that listens, as tcp/HOST:PORT; found by multicast if None.
        timeout: seconds to wait for the router.

    Attributes:
        partition: of Gazebo's transport.
        dropped: how many messages were left out because too many waited.

    Raises:
        SettingsError: a name is none that Gazebo allows, or zenoh's settings in the environment are wrong.
        InvalidArgument: `router` is no endpoint; or the settings are strict, and the world steps too slowly
            for the model.
        Unavailable: no router listens there.
    """

    def __init__(
        self,
        predictor: Predictor,
        settings: BridgeSettings,
        *,
        partition: str | None = None,
        router: str | None = None,
        timeout: float = 5.0,
    ) -> None:
        self.partition = own_partition() if partition is None else partition
        self.dropped = 0
        self._settings, self._node = settings, GazeboNode(self.partition)
        self._bridge = TactileBridge(predictor, settings)
        self._arrived: queue.Queue[_Arrived | None] = queue.Queue(_WAITING_MESSAGES)
        config = zenoh_config(router, timeout)
        try:
            self._session = open_session(config)
        except zenoh.ZError as error:
            where = "" if router is None else f" to {router} within {timeout:g} s"
            raise Unavailable(f"no way{where} into the network of Gazebo: {reason_of(error)}") from None
        self._declared: list[Any] = []
        self._publishers = [self._publisher(finger.channels) for finger in settings.fingers]
        for source in self._inputs():
            self._subscribe(source)

    @property
    def refused(self) -> int:
        """How many messages could not be used."""
        return self._bridge.refused

    def _inputs(self) -> list[_Input]:
        bridge = self._bridge
        contacts = [
            _Input(finger.contacts, CONTACTS, partial(bridge.take_contacts, number))
            for number, finger in enumerate(self._settings.fingers)
        ]
        return [
            _Input(self._settings.pose_topic, POSES, bridge.take_poses),
            *contacts,
            _Input(self._settings.clock, CLOCK, bridge.take_clock),
        ]

    def _publisher(self, topic: str) -> zenoh.Publisher:
        self._announce(self._node.publisher_token(topic, CHANNELS))
        return self._session.declare_publisher(
            self._node.key(topic), congestion_control=zenoh.CongestionControl.DROP
        )

    def _subscribe(self, source: _Input) -> None:
        def take(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            name = "" if attachment is None else attachment.to_bytes().decode(errors="replace")
            # zenoh's threads must not wait for a predictor.
            try:
                self._arrived.put_nowait(_Arrived(source, name, sample.payload.to_bytes()))
            except queue.Full:
                self.dropped += 1

        key = self._node.key(source.topic)
        self._declared.append(self._session.declare_subscriber(key, Callback(take, indirect=False)))
        self._announce(self._node.subscription_token(source.topic, source.type))

    def _announce(self, token: str) -> None:
        self._declared.append(self._session.liveliness().declare_token(token))

    def run(self, on_prediction: Callable[[Prediction], None] | None = None) -> None:
        """Take messages and publish until `stop` is called, in this thread.

        Args:
            on_prediction: called with whatever was published.

        Raises:
            InvalidArgument: the settings are strict, and an input is or looks wrong, or was dropped.
        """
        warns_at = time.monotonic() + _SILENCE_S
        while True:
            try:
                event = self._arrived.get(timeout=SIGNAL_CHECK_S)
            except queue.Empty:
                if time.monotonic() < warns_at:
                    continue
                warns_at = math.inf
                warn(
                    f"nothing on {self._node.key(self._settings.clock)}: expected a Gazebo that runs the "
                    f"world {self._settings.world!r} in the partition {self.partition!r} with "
                    "GZ_TRANSPORT_IMPLEMENTATION=zenoh"
                )
                continue
            if event is None:
                return
            warns_at = math.inf
            prediction = self._take(event)
            if prediction is not None and on_prediction is not None:
                on_prediction(prediction)

    def stop(self) -> None:
        """End `run`, from any thread."""
        self._arrived.put(None)

    def close(self) -> None:
        """Leave the network."""
        close_session(self._session)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _take(self, event: _Arrived) -> Prediction | None:
        source = event.source
        # As Gazebo's own subscribers do.
        if event.type != source.type:
            self._bridge.tell(
                f"{source.topic} carries {event.type or 'untyped messages'}: expected {source.type}"
            )
            return None
        prediction = source.take(event.payload)
        if prediction is not None:
            for publisher, channels in zip(self._publishers, prediction.channels, strict=True):
                publisher.put(channel_payload(channels, prediction.stamp_ns), attachment=CHANNELS.encode())
        if self.dropped:
            self._bridge.tell("messages were dropped: they come faster than predictions")
        return prediction
