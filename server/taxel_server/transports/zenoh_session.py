"""The zenoh session that a server listens with."""

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any, Final

import zenoh

from taxel import zenoh_process
from taxel.endpoints import EXPECTED, reason_of
from taxel.errors import SettingsError, TaxelError

_PATIENCE_S: Final = 0.25
"""How long an answer waits for a client that reads nothing; then that client is disconnected.

A client whose connection may be full has a thread of its own, but zenoh's threads wait for it, too, and
now and then the worker. zenoh's default of 5 s would hold up all other clients for as long.
"""

SEND_BUFFER: Final = 256 * 2**10
"""Bytes of the answers to a client that Linux keeps, before zenoh waits; it doubles this figure.

By default it grows to 4 MB, of which a third must be free again before Linux lets zenoh write. A client
that reads 2 MB/s then seems to have stopped, and would be disconnected. A smaller one than this
disconnects clients that pause while they are given large answers.
"""

_RUNTIME: Final = (
    "(rx: (worker_threads: 8), net: (handover: rx), acc: (handover: rx), tx: (worker_threads: 1))"
)
"""zenoh's threads: a pool of eight receives, and one thread sends.

The two must not share a thread. zenoh ends a query on a receiving thread, and this may wait for memory
that only the sending task gives back. On a shared thread both then wait until zenoh closes the
connection, and the client's next queries are lost. There are several receiving threads because one of
them may wait for a client that reads nothing, as long as `_PATIENCE_S`.
"""


def open_session(
    listen: Sequence[str],
    *,
    shared_memory: bool = False,
    max_message_bytes: int | None = None,
    security: Mapping[str, Any] | None = None,
) -> zenoh.Session:
    """Listen on endpoints, as a router: clients need no other process between.

    Args:
        listen: endpoints, such as `tcp/127.0.0.1:7447`.
        shared_memory: whether large messages of clients on this machine go through shared memory,
            where they ask for it, too.
        max_message_bytes: a larger message is dropped before it is put together. None: zenoh's
            own limit.
        security: further settings, of who gets in and what they may do.

    Raises:
        SettingsError: an endpoint is malformed.
        TaxelError: an endpoint cannot be listened on, as another process does so already.
    """
    # zenoh reads this once, when the process opens its first session.
    os.environ.setdefault("ZENOH_RUNTIME", _RUNTIME)
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": "router",
        "scouting/multicast/enabled": False,
        "scouting/delay": 0,
        "transport/shared_memory/enabled": shared_memory,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": round(_PATIENCE_S * 1e6),
    }
    if max_message_bytes is not None:
        settings["transport/link/rx/max_message_size"] = max_message_bytes
    settings.update(security or {})
    for link in ("tcp", "tls"):
        settings[f"transport/link/{link}/so_sndbuf"] = SEND_BUFFER
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    endpoints = ", ".join(listen)
    try:
        config.insert_json5("listen/endpoints", json.dumps(list(listen)))
    except zenoh.ZError:
        raise SettingsError(f"listen: {endpoints}: {EXPECTED}") from None
    try:
        return zenoh_process.open_session(config)
    except zenoh.ZError as error:
        # ROS 2's router has the same default port.
        hint = "; rmw_zenohd of ROS 2 listens on 7447, too" if ":7447" in endpoints else ""
        raise TaxelError(f"cannot listen on {endpoints}: {reason_of(error)}{hint}") from None
