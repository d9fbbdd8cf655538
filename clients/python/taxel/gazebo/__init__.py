"""Fingertips for Gazebo: contacts from its topics and channels back, over its transport on zenoh."""
