"""Predictors that a Taxel server evaluates, reached over zenoh, over the lane, or in process.

One core (`core`) has two faces: `source`, whose calls wait, and `async_source`, whose calls are awaited.
"""

from taxel.remote.options import Transport
from taxel.remote.source import RemotePredictor, RemoteSource, connect

__all__ = ["RemotePredictor", "RemoteSource", "Transport", "connect"]
