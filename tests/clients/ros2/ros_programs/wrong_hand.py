"""Publishes contacts in ROS 2 until diagnostics say a text of `ff`; run by ROS's Python.

    python wrong_hand.py TEXT PLACE_Z FORCE_Z --ros-args -r __ns:=/rh

stdout: [level, message], or [-1, the last message] after a minute
"""

import json
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, WrenchStamped

text, place, force = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
rclpy.init()
node = rclpy.create_node("hand")
wrenches = node.create_publisher(WrenchStamped, "ff/wrench", 50)
points = node.create_publisher(PointStamped, "ff/point", 50)
told = [-1, ""]


def hear(message: DiagnosticArray) -> None:
    for status in message.status:
        if status.name == "taxel: ff" and told[0] < 0:
            told[:] = [status.level[0] if text in status.message else -1, status.message]


node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
for step in range(6000):
    if told[0] >= 0:
        break
    point, wrench = PointStamped(), WrenchStamped()
    for message in (point, wrench):
        message.header.stamp.sec, message.header.stamp.nanosec = (
            1_700_000_000 + step // 100,
            step % 100 * 10**7,
        )
        message.header.frame_id = "ff_biotac"
    point.point.z, wrench.wrench.force.z = place, force
    points.publish(point)
    wrenches.publish(wrench)
    until = time.monotonic() + 0.01
    while (left := until - time.monotonic()) > 0:
        rclpy.spin_once(node, timeout_sec=left)
json.dump(told, sys.stdout)
rclpy.shutdown()
