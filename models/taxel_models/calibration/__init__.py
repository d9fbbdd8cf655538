"""Calibration: the sensor's place in a recording's frame, estimated from light contacts on its skin."""
