"""The one window builder: training, evaluation, clients and the loop all use it."""

from taxel.windows.batch import Windows, build_windows
from taxel.windows.combinations import COMBINATIONS, PERIOD_NS, WindowSpec
from taxel.windows.samples import Samples, resample
from taxel.windows.stream import LiveWindow, WindowStream

__all__ = [
    "COMBINATIONS",
    "PERIOD_NS",
    "LiveWindow",
    "Samples",
    "WindowSpec",
    "WindowStream",
    "Windows",
    "build_windows",
    "resample",
]
