"""Opens a client's zenoh session, and tells a server that turns the client away from none."""

import json
import socket
import ssl
import time
from typing import Any, Final

import zenoh

from taxel.endpoints import checked_endpoint, host_and_port_of, reason_of
from taxel.errors import InvalidArgument, PermissionDenied, Unavailable
from taxel.remote.credentials import Credentials
from taxel.zenoh_process import open_session

_RETRY: Final = {"period_init_ms": 100, "period_max_ms": 400, "period_increase_factor": 2}
"""When zenoh looks again for a server that was lost. By default it waits 1 s and longer."""

_PAUSE_S: Final = 0.1
"""Between two attempts to open a session."""

_CERTAIN_S: Final = 0.4
"""A server that is starting or stopping, or has too many clients at once, turns a client away for a moment.
One that still does so after this time means it."""

_PATIENCE_S: Final = 0.25, 5.0
"""Least and most time that a request waits to be sent to a server that reads nothing. Then zenoh ends the
connection, and looks for the server again. The most is zenoh's own default: then a call waits for so long,
however short its timeout is."""

_KNOCK_S: Final = 0.25
"""How long to wait for an answer when looking whether somebody listens."""


def open_client_session(
    endpoint: str, timeout: float, patience: float, *, shared_memory: bool, credentials: Credentials
) -> zenoh.Session:
    """A session with whoever listens at an endpoint.

    Args:
        endpoint: such as `tcp/127.0.0.1:7447`.
        timeout: seconds to wait for a server.
        patience: seconds that a request may wait to be sent.
        shared_memory: whether large messages go through shared memory.
        credentials: what the client shows.

    Raises:
        InvalidArgument: that is no endpoint.
        PermissionDenied: somebody listens there, but turns this client away, or is not trusted.
        Unavailable: nobody listens there.
    """
    ends = time.monotonic() + timeout
    least, most = _PATIENCE_S
    patience = min(max(patience, least), most)
    turned_away_at: float | None = None
    while True:
        began = time.monotonic()
        left = max(ends - began, 1e-3)
        try:
            return open_session(_config(endpoint, left, patience, shared_memory, credentials))
        except zenoh.ZError as error:
            reason = reason_of(error)
        last = time.monotonic() + _PAUSE_S > ends
        # zenoh tells no reason. Where nobody listens a knock fails, too, and a stuck server is slow.
        if time.monotonic() - began < left / 2 and _listens(endpoint):
            turned_away_at = turned_away_at or began
            if last or time.monotonic() - turned_away_at >= _CERTAIN_S:
                raise PermissionDenied(_turned_away(endpoint, credentials))
        elif last:
            raise Unavailable(
                f"no server at {endpoint} within {timeout:g} s; expected a `taxel serve` that has printed"
                f" 'listening on': {reason}"
            )
        else:
            turned_away_at = None
        time.sleep(_PAUSE_S)


def _config(
    endpoint: str, left: float, patience: float, shared_memory: bool, credentials: Credentials
) -> zenoh.Config:
    settings: dict[str, Any] = {
        "mode": "client",
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": shared_memory,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": round(patience * 1e6),
        "transport/unicast/open_timeout": max(round(left * 1e3), 1),
        # One attempt; a session that was open connects again without end.
        "connect/timeout_ms": 0,
        "connect/exit_on_failure": True,
        "connect/retry": _RETRY,
        **credentials.zenoh_settings(),
    }
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        config.insert_json5("connect/endpoints", json.dumps([checked_endpoint(endpoint)]))
    except zenoh.ZError as error:
        raise InvalidArgument(f"endpoint {endpoint!r}: {reason_of(error)}") from None
    return config


def _listens(endpoint: str) -> bool:
    """Whether somebody takes connections there, as far as it can be seen."""
    address = host_and_port_of(endpoint)
    try:
        if address is None:
            return False
        socket.create_connection(address, timeout=_KNOCK_S).close()
    except OSError:
        return False
    return True


def _turned_away(endpoint: str, credentials: Credentials) -> str:
    if distrust := _distrust(endpoint, credentials):
        return (
            f"{endpoint}: this client does not trust the server's certificate: {distrust}; expected one "
            f"for this host, signed by {credentials.ca or 'a well-known authority, or ca=FILE'}"
        )
    shown = f"user {credentials.user!r}" if credentials.user is not None else "no user"
    certificate = credentials.certificate or "no certificate"
    return (
        f"{endpoint}: a server is there, but turns this client away, which showed {shown} and "
        f"{certificate}: expected a user and password, a certificate, and a protocol that it takes"
    )


def _distrust(endpoint: str, credentials: Credentials) -> str:
    """Why the certificate at an endpoint with TLS is not trusted; nothing if it is, or if there is none."""
    address = host_and_port_of(endpoint)
    if not endpoint.startswith("tls/") or address is None:
        return ""
    try:
        context = ssl.create_default_context(cafile=credentials.ca)
    except ssl.SSLError:
        return f"{credentials.ca} holds no certificate"
    try:
        with (
            socket.create_connection(address, timeout=_KNOCK_S) as plain,
            context.wrap_socket(plain, server_hostname=address[0]),
        ):
            return ""
    except ssl.SSLCertVerificationError as error:
        return error.verify_message
    except OSError:
        return ""
