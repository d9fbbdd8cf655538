"""The zenoh session that a server listens with."""

import json
from collections.abc import Sequence
from typing import Final

import zenoh

from taxel.errors import SettingsError

_PATIENCE_S: Final = 0.5
"""How long an answer waits for a client that reads nothing; then that client is disconnected.

zenoh's default of 5 s would let one stuck client hold up all others for as long.
"""


def open_session(listen: Sequence[str]) -> zenoh.Session:
    """Listen on endpoints, as a router: clients need no other process between.

    Raises:
        SettingsError: an endpoint is malformed or occupied.
    """
    config = zenoh.Config()
    settings = {
        "mode": "router",
        "scouting/multicast/enabled": False,
        "scouting/delay": 0,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": round(_PATIENCE_S * 1e6),
        "listen/endpoints": list(listen),
    }
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        # What follows ' at /' is where zenoh was built.
        reason = str(error).partition(" at /")[0]
        raise SettingsError(f"cannot listen on {', '.join(listen)}: {reason}") from None
