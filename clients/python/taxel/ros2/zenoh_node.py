"""The node over zenoh alone, as `rmw_zenoh_cpp` would speak: no ROS is needed where it runs."""

import json
import queue
import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple, Self

import zenoh
from zenoh.handlers import Callback

from taxel.endpoints import checked_endpoint, reason_of
from taxel.errors import InvalidArgument, Unavailable
from taxel.predictor import Predictor
from taxel.ros2.cdr import CdrTypes, decode, encode, type_hash
from taxel.ros2.messages import biotac_all, channel_array, diagnostic_array
from taxel.ros2.rmw_zenoh import TOKENS, NodeName, Qos, Topic, announced, attachment, checked_name, gid_of
from taxel.ros2.settings import NodeSettings
from taxel.ros2.tactile_node import Output, TactileNode
from taxel.ros2.topics import (
    DIAGNOSTICS_EVERY_S,
    DIAGNOSTICS_TOPIC,
    HAND_TOPIC,
    InputTopic,
    channel_topic,
    contact_of,
    input_topics,
    output_topics,
)
from taxel.zenoh_process import close_session, open_session

_WAITING_MESSAGES: Final = 1000
"""Messages that wait for the predictor; further ones are dropped, and counted."""

_INPUT_QOS: Final = Qos(depth=50, reliable=False)
"""As sensors publish: every publisher's QoS fits it."""

_OUTPUT_QOS: Final = Qos(depth=10)


class _Arrived(NamedTuple):
    """A message of a topic that brings contacts."""

    topic: InputTopic
    payload: bytes


class _Token(NamedTuple):
    """A token that has come, or has gone."""

    key: str
    alive: bool


class _Publisher:
    """Publishes one topic: payloads with the attachment that receivers want."""

    def __init__(self, session: zenoh.Session, topic: Topic, token: str, domain: int) -> None:
        self._gid = gid_of(token)
        self._sequence = 0
        self.type = topic.type
        self._publisher = session.declare_publisher(
            topic.key(domain),
            congestion_control=zenoh.CongestionControl.DROP,
            reliability=zenoh.Reliability.RELIABLE,
        )
        self.token = session.liveliness().declare_token(token)

    def publish(self, message: Any) -> None:
        self._sequence += 1
        self._publisher.put(
            encode(message, self.type), attachment=attachment(self._sequence, time.time_ns(), self._gid)
        )


class ZenohNode:
    """A node of fingertips on a network of `rmw_zenoh_cpp`.

    Args:
        predictor: predicts the channels.
        settings: the fingers.
        router: the network's zenoh router, as tcp/HOST:PORT.
        domain: `ROS_DOMAIN_ID`.
        name: of the node.
        namespace: of its topics.
        timeout: seconds to wait for the router.

    Attributes:
        dropped: how many messages were left out because too many waited.

    Raises:
        SettingsError: a name is none that ROS allows.
        InvalidArgument: `router` is no endpoint; or the settings are strict, and contacts are to come too
            slowly for the model.
        Unavailable: no router listens there.
    """

    def __init__(
        self,
        predictor: Predictor,
        settings: NodeSettings,
        *,
        router: str = "tcp/localhost:7447",
        domain: int = 0,
        name: str = "taxel",
        namespace: str = "/",
        timeout: float = 5.0,
    ) -> None:
        name = checked_name("node", name)
        namespace = "/" + checked_name("namespace", namespace).strip("/")
        self._node = TactileNode(predictor, settings)
        self._types = CdrTypes()
        self._arrived: queue.Queue[_Arrived | _Token | None] = queue.Queue(_WAITING_MESSAGES)
        self._wrong_topics: dict[str, tuple[str, str]] = {}
        self._topics: dict[str, tuple[Topic, str]] = {}
        self.dropped = 0
        self._session = _open(router, timeout)
        self._own = NodeName(domain, str(self._session.info.zid()), 0, name, namespace)
        self._declared: list[Any] = [self._session.liveliness().declare_token(self._own.token)]
        self._publishers: dict[str, _Publisher] = {}
        self._declare(settings)

    def _declare(self, settings: NodeSettings) -> None:
        domain, number = self._own.domain, 1
        for name, kind in output_topics(settings).items():
            topic = Topic(self._full(name), kind, type_hash(kind))
            token = self._own.publisher_token(number, topic, _OUTPUT_QOS)
            self._publishers[name] = _Publisher(self._session, topic, token, domain)
            number += 1
        for source in input_topics(settings):
            topic = Topic(self._full(source.name), source.type, type_hash(source.type))
            self._topics[topic.name] = topic, source.finger
            token = self._own.subscription_token(number, topic, _INPUT_QOS)
            self._declared += [
                self._session.declare_subscriber(topic.key(domain), self._listener(source)),
                self._session.liveliness().declare_token(token),
            ]
            number += 1
        self._declared.append(
            self._session.liveliness().declare_subscriber(
                f"{TOKENS}/{domain}/**", Callback(self._hear, indirect=False), history=True
            )
        )

    def _full(self, name: str) -> str:
        return name if name.startswith("/") else f"{self._own.namespace.rstrip('/')}/{name}"

    def _listener(self, source: InputTopic) -> "Callback[zenoh.Sample]":
        def take(sample: zenoh.Sample) -> None:
            self._put(_Arrived(source, sample.payload.to_bytes()))

        return Callback(take, indirect=False)

    def _hear(self, sample: zenoh.Sample) -> None:
        self._put(_Token(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

    def _put(self, event: "_Arrived | _Token") -> None:
        # zenoh's threads must not wait for a predictor.
        try:
            self._arrived.put_nowait(event)
        except queue.Full:
            self.dropped += 1

    def run(self, on_output: Callable[[Output], None] | None = None) -> None:
        """Take messages and publish until `stop` is called, in this thread.

        Args:
            on_output: called with whatever was published.

        Raises:
            InvalidArgument: the settings are strict, and a contact looks wrong; diagnostics have told it.
        """
        due = time.monotonic() + DIAGNOSTICS_EVERY_S
        while True:
            if time.monotonic() >= due:
                due += DIAGNOSTICS_EVERY_S
                self._publish_statuses()
            try:
                event = self._arrived.get(timeout=max(due - time.monotonic(), 0.0))
            except queue.Empty:
                continue
            if event is None:
                return
            if isinstance(event, _Token):
                self._look(event)
                continue
            try:
                output = self._take(event)
            except InvalidArgument:
                self._publish_statuses()
                raise
            if on_output is not None:
                on_output(output)

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

    def _take(self, event: _Arrived) -> Output:
        now_s = time.monotonic()
        finger = event.topic.finger
        try:
            message = decode(event.payload, event.topic.type)
        except InvalidArgument as error:
            self._node.refuse(finger, f"{event.topic.name}: {error}", now_s)
            return Output([], [])
        output = self._node.take(finger, contact_of(message, event.topic.type), now_s)
        for prediction in output.predictions:
            array = channel_array(self._types, prediction.channels)
            self._publishers[channel_topic(finger)].publish(array)
        if HAND_TOPIC in self._publishers:
            for frame in output.hand:
                message = biotac_all(self._types, frame.stamp_ns, frame.channels)
                self._publishers[HAND_TOPIC].publish(message)
        return output

    def _look(self, token: _Token) -> None:
        """Whether a publisher announces one of our topics with another type, which brings no messages."""
        self._wrong_topics.pop(token.key, None)
        theirs = announced(token.key)
        if not token.alive or theirs is None or theirs.name not in self._topics:
            return
        ours, finger = self._topics[theirs.name]
        if theirs != ours:
            text = (
                f"{ours.name} is published as {theirs.type} {theirs.type_hash}: "
                f"expected {ours.type} {ours.type_hash}"
            )
            self._wrong_topics[token.key] = finger, text

    def _publish_statuses(self) -> None:
        now_s = time.monotonic()
        for finger, text in self._wrong_topics.values():
            self._node.report(finger, text, now_s)
        message = diagnostic_array(self._types, time.time_ns(), self._node.statuses(now_s, self.dropped))
        self._publishers[DIAGNOSTICS_TOPIC].publish(message)


def _open(router: str, timeout: float) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    config.insert_json5("connect/timeout_ms", str(round(timeout * 1e3)))
    config.insert_json5("connect/exit_on_failure", "true")
    config.insert_json5("connect/endpoints", json.dumps([checked_endpoint(router)]))
    try:
        return open_session(config)
    except zenoh.ZError as error:
        raise Unavailable(
            f"no zenoh router at {router} within {timeout:g} s; expected `ros2 run rmw_zenoh_cpp "
            f"rmw_zenohd`: {reason_of(error)}"
        ) from None
