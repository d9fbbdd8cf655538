"""Runs beside a server: one window, as part of a trace of the W3C."""

import sys

import numpy as np

import taxel

with taxel.connect(sys.argv[1]) as source:
    predictor = source.predictor("ffnn")
    window = np.array([predictor.manifest.typical_window], np.float32)
    predictor.predict(window, traceparent="00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01")
