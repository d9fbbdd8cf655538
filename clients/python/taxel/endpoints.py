"""zenoh's endpoints: what both ends say of one that is malformed, or that cannot be had."""

from ipaddress import ip_address
from typing import Any, Final

from taxel.errors import InvalidArgument

EXPECTED: Final = "expected PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447"
"""What an endpoint has to look like."""

_WITH_PORT: Final = frozenset({"tcp", "udp", "tls", "quic", "ws"})
_OVER_TCP: Final = frozenset({"tcp", "tls", "ws"})
_OTHERS: Final = frozenset({"unixsock-stream", "unixpipe", "serial", "vsock"})


def checked_endpoint(endpoint: Any) -> str:
    """An endpoint that zenoh can try. A wrong one it would try until the timeout, without a reason.

    Raises:
        InvalidArgument: it is no text, its protocol is not one of zenoh's, or host or port are missing.
    """
    if not isinstance(endpoint, str):
        raise InvalidArgument(f"endpoint {endpoint!r}: {EXPECTED}")
    protocol, _, address = endpoint.partition("/")
    if "://" in endpoint:
        reached = endpoint.partition("://")[2]
        raise InvalidArgument(f"endpoint {endpoint!r} is a URL: {EXPECTED}; perhaps tcp/{reached}")
    if not (protocol and address):
        raise InvalidArgument(f"endpoint {endpoint!r}: {EXPECTED}")
    if protocol in _WITH_PORT:
        _check_port(endpoint, address)
    elif protocol not in _OTHERS:
        known = ", ".join(sorted(_WITH_PORT | _OTHERS))
        raise InvalidArgument(
            f"endpoint {endpoint!r}: unknown protocol {protocol!r}: expected one of {known}"
        )
    return endpoint


def host_and_port_of(endpoint: str) -> tuple[str, int] | None:
    """Where a checked endpoint's TCP connections go; None if it has none."""
    protocol, _, address = endpoint.partition("/")
    if protocol not in _OVER_TCP:
        return None
    host, port = _parts(address)
    return host.strip("[]"), int(port)


def is_loopback(host: str) -> bool:
    """Whether a host's name or address is this machine's own, as far as its text tells."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _parts(address: str) -> tuple[str, str]:
    # What follows is for zenoh itself: `?` starts metadata, `#` starts options.
    host, _, port = address.partition("#")[0].partition("?")[0].rpartition(":")
    return host, port


def _check_port(endpoint: str, address: str) -> None:
    host, port = _parts(address)
    if not host or (":" in host and not (host.startswith("[") and host.endswith("]"))):
        raise InvalidArgument(
            f"endpoint {endpoint!r}: expected HOST:PORT behind the slash, an IPv6 address as [ADDRESS]:PORT"
        )
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65_536):
        raise InvalidArgument(f"endpoint {endpoint!r}: expected a port from 1 to 65535, not {port!r}")


def reason_of(error: Exception) -> str:
    """What zenoh's error says, without where in zenoh's own code it arose."""
    return str(error).partition(" at /")[0]
