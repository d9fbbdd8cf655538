"""Drives a server over zenoh from client processes, in the scenarios that MLPerf Inference names."""
