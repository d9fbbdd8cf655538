"""Publishes contacts in ROS 2 until diagnostics say a text of `ff` at a level; run by ROS's Python.

    python wrong_hand.py LEVEL TEXT PLACE_Z FORCE_Z --ros-args -r __ns:=/rh

stdout: the last [level, message], after a minute at the latest
"""

import json
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, WrenchStamped

level, text, place, force = int(sys.argv[1]), sys.argv[2], float(sys.argv[3]), float(sys.argv[4])
rclpy.init()
node = rclpy.create_node("hand")
wrenches = node.create_publisher(WrenchStamped, "ff/wrench", 50)
points = node.create_publisher(PointStamped, "ff/point", 50)
told = [-1, ""]


def is_told() -> bool:
    return told[0] == level and text in str(told[1])


def hear(message: DiagnosticArray) -> None:
    for status in message.status:
        # A fault of the start, when only one of the finger's two topics was found, is told once.
        if status.name == "taxel: ff" and not is_told():
            told[:] = [status.level[0], status.message]


node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
for step in range(6000):
    if is_told():
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
