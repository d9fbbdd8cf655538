"""Serving: artifacts in, predictions out, in this process or over zenoh."""
