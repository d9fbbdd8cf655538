"""A program with several clients of one server, which leave or are to be killed.

    python -m taxel_bench.churn.clients ENDPOINT TRANSPORT MODEL CLIENTS ROWS close|stay

It prints `ready` once each client has its answers. With `stay`, all go on asking until it is killed.
"""

import sys
from threading import Thread
from typing import cast

import numpy as np

import taxel
from taxel.predictor import Predictor
from taxel.remote.options import Transport


def main(endpoint: str, transport: Transport, model: str, clients: int, rows: int, *, stay: bool) -> None:
    """Be some clients, each with a connection of its own."""
    for _ in range(clients):
        source = taxel.connect(endpoint, transport=transport, timeout=30)
        predictor = source.predictor(model)
        windows = np.tile(np.array(predictor.manifest.typical_window, np.float32), (rows, 1))
        predictor.predict(windows[:1])
        predictor.predict(windows)
        if stay:
            Thread(target=_ask_on, args=(predictor, windows), daemon=True).start()
        else:
            source.close()
    print("ready", flush=True)
    if stay:
        sys.stdin.read()


def _ask_on(predictor: Predictor, windows: np.ndarray) -> None:
    while True:
        predictor.predict(windows)


if __name__ == "__main__":
    place, way, name, count, size, leave = sys.argv[1:]
    main(place, cast("Transport", way), name, int(count), int(size), stay=leave == "stay")
