"""Recordings: what a real or simulated sensor measured, read, written, summarised and drawn."""

from taxel_models.recordings.reading import read_recording
from taxel_models.recordings.recording import Recording
from taxel_models.recordings.ros_bag import read_ros_bag
from taxel_models.recordings.ros_bag_writing import write_ros_bag
from taxel_models.recordings.ruppel import has_channels, read_contacts, read_ruppel, write_ruppel
from taxel_models.recordings.slide import read_slide

__all__ = [
    "Recording",
    "has_channels",
    "read_contacts",
    "read_recording",
    "read_ros_bag",
    "read_ruppel",
    "read_slide",
    "write_ros_bag",
    "write_ruppel",
]
