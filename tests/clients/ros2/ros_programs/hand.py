"""Plays the rest of a robot in ROS 2: publishes contacts, prints what the node gives; run by ROS's Python.

    python hand.py STEPS --ros-args -r __ns:=/rh

stdout: {"arrays": [[counts]], "hands": [[stamp_ns, [[electrodes] of five]]],
         "statuses": {name: [level, message]}}
"""

import json
import sys
import time
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped, WrenchStamped
from rclpy.node import Node
from sr_robot_msgs.msg import BiotacAll
from std_msgs.msg import Float32MultiArray

START_S = 1_700_000_000


class Hand(Node):
    def __init__(self) -> None:
        super().__init__("hand")
        self.arrays: list[list[float]] = []
        self.hands: list[Any] = []
        self.statuses: dict[str, Any] = {}
        self.wrench = {f: self.create_publisher(WrenchStamped, f"{f}/wrench", 50) for f in ("ff", "th")}
        self.point = self.create_publisher(PointStamped, "ff/point", 50)
        self.create_subscription(
            Float32MultiArray, "ff/tactile", lambda m: self.arrays.append(list(m.data)), 50
        )
        self.create_subscription(BiotacAll, "tactile", self.take_hand, 50)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.take_status, 10)

    def take_hand(self, message: BiotacAll) -> None:
        stamp = message.header.stamp
        electrodes = [list(tactile.electrodes) for tactile in message.tactiles]
        self.hands.append([stamp.sec * 10**9 + stamp.nanosec, electrodes])

    def take_status(self, message: DiagnosticArray) -> None:
        self.statuses |= {s.name: [s.level[0], s.message] for s in message.status}

    def play(self, step: int) -> None:
        """Publish the contacts of one step, and hear what comes: the answer, or nothing for 10 ms or so."""
        self.publish(step)
        heard = len(self.hands)
        # A node that has begun to answer answers every step; a busy machine may take its time.
        patience = 10.0 if self.answers(step) else 0.01
        until = time.monotonic() + patience
        while len(self.hands) == heard and (left := until - time.monotonic()) > 0:
            rclpy.spin_once(self, timeout_sec=left)

    def answers(self, step: int) -> bool:
        """Whether the node has had enough contacts of this play to answer each."""
        return step >= 30

    def publish(self, step: int) -> None:
        point, wrench, wrong = PointStamped(), WrenchStamped(), WrenchStamped()
        for message in (point, wrench, wrong):
            message.header.stamp.sec = START_S + step // 100
            message.header.stamp.nanosec = step % 100 * 10_000_000
            message.header.frame_id = "ff_biotac"
        point.point.x, point.point.z = -0.001 * (step % 5), -0.007
        wrench.wrench.force.y, wrench.wrench.force.z = 0.2, 0.02 * (step % 100)
        self.point.publish(point)
        self.wrench["ff"].publish(wrench)
        wrong.header.frame_id = "world"
        self.wrench["th"].publish(wrong)


rclpy.init()
hand = Hand()
# Until each end has found the other: contacts of long before, which a gap in time sets apart.
step = -100_000
while not (hand.arrays and hand.hands):
    hand.play(step)
    step += 1
for step in range(int(sys.argv[1])):
    hand.play(step)
hand.statuses.clear()
while not {"taxel: ff", "taxel: th", "taxel: predictor"} <= set(hand.statuses):
    rclpy.spin_once(hand, timeout_sec=0.1)
statuses = dict(hand.statuses)
# A fault of the start, when only one of the finger's two topics was found, is told once, and then no more.
until = time.monotonic() + 10.0
while hand.statuses["taxel: ff"][0] == DiagnosticStatus.ERROR[0] and time.monotonic() < until:
    rclpy.spin_once(hand, timeout_sec=0.1)
statuses["taxel: ff"] = hand.statuses["taxel: ff"]
json.dump({"arrays": hand.arrays, "hands": hand.hands, "statuses": statuses}, sys.stdout)
rclpy.shutdown()
