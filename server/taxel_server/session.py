"""The zenoh session that a server listens with."""

import json
import os
from collections.abc import Sequence
from typing import Final

import zenoh

from taxel.errors import SettingsError, TaxelError

_PATIENCE_S: Final = 0.5
"""How long an answer waits for a client that reads nothing; then that client is disconnected.

zenoh's default of 5 s would let one stuck client hold up all others for as long.
"""

_RUNTIME: Final = "(rx: (worker_threads: 1), net: (handover: rx), acc: (handover: rx), tx: (handover: rx))"
"""zenoh's four pools of threads as one, of one thread, which a query then wakes instead of several.

It waits for Python only when the channel that queries go into is full; answers come from other threads.
"""


def open_session(listen: Sequence[str]) -> zenoh.Session:
    """Listen on endpoints, as a router: clients need no other process between.

    Raises:
        SettingsError: an endpoint is malformed.
        TaxelError: an endpoint cannot be listened on, as another process does so already.
    """
    # zenoh reads this once, when the process opens its first session.
    os.environ.setdefault("ZENOH_RUNTIME", _RUNTIME)
    config = zenoh.Config()
    settings = {
        "mode": "router",
        "scouting/multicast/enabled": False,
        "scouting/delay": 0,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": round(_PATIENCE_S * 1e6),
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    endpoints = ", ".join(listen)
    try:
        config.insert_json5("listen/endpoints", json.dumps(list(listen)))
    except zenoh.ZError:
        raise SettingsError(
            f"listen: {endpoints}: expected PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447"
        ) from None
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        # What follows ' at /' is where zenoh was built.
        reason = str(error).partition(" at /")[0]
        raise TaxelError(f"cannot listen on {endpoints}: {reason}") from None
