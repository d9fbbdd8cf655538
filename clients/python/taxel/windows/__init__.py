"""The one window builder: training, evaluation, clients and the loop all use it."""

from taxel.windows.batch import Windows, build_windows
from taxel.windows.combinations import COMBINATIONS, PERIOD_NS, WindowSpec
from taxel.windows.extras import ExtraFeature, extra_columns
from taxel.windows.history import (
    BoundedRate,
    Direction,
    Elapsed,
    Friction,
    HistoryFeature,
    Load,
    LoadAbove,
    Play,
    Rate,
    Relaxation,
    RelaxationShare,
    Speed,
    Warmth,
    history_columns,
)
from taxel.windows.samples import Samples, resample
from taxel.windows.stream import LiveWindow, WindowStream

__all__ = [
    "COMBINATIONS",
    "PERIOD_NS",
    "BoundedRate",
    "Direction",
    "Elapsed",
    "ExtraFeature",
    "Friction",
    "HistoryFeature",
    "LiveWindow",
    "Load",
    "LoadAbove",
    "Play",
    "Rate",
    "Relaxation",
    "RelaxationShare",
    "Samples",
    "Speed",
    "Warmth",
    "WindowSpec",
    "WindowStream",
    "Windows",
    "build_windows",
    "extra_columns",
    "history_columns",
    "resample",
]
