"""The node in ROS 2 itself, over whatever middleware it runs on.

    python -m taxel.ros2.rclpy_node --ros-args -r __ns:=/rh -p model:=ffnn-causal

It runs with ROS's own Python, in which Taxel is installed. `sr_robot_msgs` and `tactile_msgs` are not part
of ROS: without the first, BiotacAll is not published, which the log says.
"""

import time
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import rclpy
from numpy.typing import NDArray
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from taxel.commands.models import open_source
from taxel.errors import InvalidArgument, SettingsError, TaxelError
from taxel.predictor import DEFAULT_MODEL
from taxel.ros2.messages import Status, biotac_all, channel_array, diagnostic_array
from taxel.ros2.settings import Inputs, NodeSettings
from taxel.ros2.tactile_node import TactileNode
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

_INPUT_QOS: Final = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
_OUTPUT_QOS: Final = QoSProfile(depth=10)
_ANY_TYPE: Final = ParameterDescriptor(dynamic_typing=True)


class RclpyTypes:
    """rclpy's classes, for `taxel.ros2.messages`."""

    def type_of(self, name: str) -> Any:
        """The class of a message, such as `std_msgs/msg/Header`.

        Raises:
            ModuleNotFoundError: its package is not there.
        """
        package, kind, short = name.split("/")
        return getattr(import_module(f"{package}.{kind}"), short)

    def array(self, values: NDArray[Any]) -> Any:
        """A sequence of numbers."""
        return values.tolist()

    def byte(self, value: int) -> bytes:
        """A field of the type `byte`."""
        return bytes([value])


class FingertipNode(Node):  # type: ignore[misc]
    """A node of fingertips.

    Its parameters are those of `NodeSettings`, and `model`, `connect` (a server's endpoint) and
    `repository`; if neither of the last two is given, it predicts with the models that come with Taxel.

    Args:
        arguments: rclpy's own, such as `namespace` and `parameter_overrides`.

    Raises:
        TaxelError: a parameter is wrong, a message's package is not there, or the model cannot be had.
    """

    def __init__(self, **arguments: Any) -> None:
        super().__init__("taxel", **arguments)
        self._types = RclpyTypes()
        settings = self._declared_settings()
        connect, repository = self._text("connect", ""), self._text("repository", "")
        self._source = open_source(connect or None, Path(repository) if repository else None)
        self._node = TactileNode(self._source.predictor(self._text("model", DEFAULT_MODEL)), settings)
        self._told: dict[str, str] = {}
        self._outputs = {
            name: self._publisher(name, kind) for name, kind in output_topics(settings).items()
        }
        self._inputs = [self._subscription(topic) for topic in input_topics(settings)]
        self._timer = self.create_timer(DIAGNOSTICS_EVERY_S, self._diagnose)

    def _text(self, name: str, default: str) -> str:
        return str(self._value(name, default))

    def _number(self, name: str, default: float) -> float:
        # 500 is a whole number to ROS, and means 500.0.
        value: Any = self.declare_parameter(name, default, _ANY_TYPE).value
        return float(value) if isinstance(value, int) and not isinstance(value, bool) else value

    def _value(self, name: str, default: Any) -> Any:
        try:
            return self.declare_parameter(name, default).value
        except InvalidParameterTypeException as error:
            raise SettingsError(f"the parameter {name}: {error}") from None

    def _declared_settings(self) -> NodeSettings:
        default = NodeSettings()
        # An empty list has no type in ROS, and comes as None.
        fingers = self._value("fingers", list(default.fingers)) or ()
        inputs = self._text("inputs", default.inputs.value)
        if inputs not in [known.value for known in Inputs]:
            raise SettingsError(f"inputs is {inputs!r}: expected {' or '.join(Inputs)}")
        numbers = {
            name: self._number(name, getattr(default, name))
            for name in ("rate_hz", "pair_within_s", "stale_after_s")
        }
        frame_id, strict = self._text("frame_id", default.frame_id), self._value("strict", default.strict)
        return NodeSettings(tuple(fingers), frame_id, Inputs(inputs), **numbers, strict=strict)

    def _publisher(self, name: str, kind: str) -> Any:
        try:
            message = self._types.type_of(kind)
        except ModuleNotFoundError as error:
            self.get_logger().warning(f"{name} is not published: the package {error.name} is not here")
            return None
        return self.create_publisher(message, name, _OUTPUT_QOS)

    def _subscription(self, topic: InputTopic) -> Any:
        def take(message: Any) -> None:
            now_s = time.monotonic()
            try:
                output = self._node.take(topic.finger, contact_of(message, topic.type), now_s)
            except InvalidArgument:
                self._diagnose()
                raise
            for prediction in output.predictions:
                self._publish(channel_topic(topic.finger), channel_array(self._types, prediction.channels))
            if self._outputs.get(HAND_TOPIC) is not None:
                for frame in output.hand:
                    self._publish(HAND_TOPIC, biotac_all(self._types, frame.stamp_ns, frame.channels))

        try:
            message_type = self._types.type_of(topic.type)
        except ModuleNotFoundError as error:
            raise SettingsError(
                f"{topic.name} is {topic.type}: expected the package {error.name} to be installed in ROS"
            ) from None
        return self.create_subscription(message_type, topic.name, take, _INPUT_QOS)

    def _publish(self, name: str, message: Any) -> None:
        if (publisher := self._outputs[name]) is not None:
            publisher.publish(message)

    def _diagnose(self) -> None:
        statuses = self._node.statuses(time.monotonic())
        if self._outputs[DIAGNOSTICS_TOPIC] is not None:
            now_ns = self.get_clock().now().nanoseconds
            self._publish(DIAGNOSTICS_TOPIC, diagnostic_array(self._types, now_ns, statuses))
        for status in statuses:
            self._log(status)

    def _log(self, status: Status) -> None:
        """Log what is new."""
        level = status.level.name
        if self._told.get(status.name) != level:
            self._told[status.name] = level
            text = f"{status.name}: {level}: {status.message}"
            # rclpy allows one severity for each line of code.
            if level == "OK":
                self.get_logger().info(text)
            else:
                self.get_logger().warning(text)

    def close(self) -> None:
        """Leave ROS, and release the model."""
        self.destroy_node()
        self._source.close()


def main() -> None:
    """Run a node until it is interrupted, or a strict one until a contact looks wrong."""
    rclpy.init()
    try:
        node = FingertipNode()
    except TaxelError as error:
        raise SystemExit(f"taxel: {error}") from None
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except TaxelError as error:
        raise SystemExit(f"taxel: {error}") from None
    finally:
        node.close()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
