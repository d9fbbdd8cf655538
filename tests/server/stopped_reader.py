"""A client of its own process that asks much, and then stops reading: run by test_lost_requests.py."""

import os
import signal
import sys

import numpy as np

import taxel
from taxel.protocol import model_key, pack_infer_request


def main(endpoint: str) -> None:
    """Connect, wait for a line, send 200 requests of 1000 windows, stop."""
    source = taxel.connect(endpoint, transport="zenoh")
    windows = np.zeros((1000, 12), dtype=np.float32)
    source.predictor("wide").predict(windows)
    print("ready", flush=True)
    sys.stdin.readline()
    request = pack_infer_request(windows, timeout_ms=5000)
    for _ in range(200):
        source.connection.send(model_key("taxel", "wide", "1", "infer"), request, 5.0, lambda _: None)
    os.kill(os.getpid(), signal.SIGSTOP)


if __name__ == "__main__":
    main(sys.argv[1])
