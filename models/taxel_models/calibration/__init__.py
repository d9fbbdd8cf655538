"""Geometry: where the sensor is in a recording's frame, estimated from light contacts on its skin."""
