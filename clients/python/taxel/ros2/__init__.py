"""Fingertips in ROS 2: in rclpy (`rclpy_node`) or by zenoh alone (`zenoh_node`)."""
