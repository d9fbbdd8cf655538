"""Tells systemd, or another service manager with its protocol, how the server is.

https://www.freedesktop.org/software/systemd/man/latest/sd_notify.html
"""

import os
import socket
import time
from contextlib import suppress
from typing import Final

_SHARE: Final = 0.4
"""Signs of life are sent so often, as a share of the watchdog's time; systemd recommends half."""


class ServiceManager:
    """Sends states to the socket of `NOTIFY_SOCKET`; does nothing where there is none."""

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        watchdog_us = os.environ.get("WATCHDOG_USEC", "")
        ours = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._period_s = _SHARE * int(watchdog_us) / 1e6 if watchdog_us.isdigit() and ours else 0.0
        self._next = 0.0

    def tell(self, *states: str) -> None:
        """Send states such as `READY=1`."""
        if not self._address.startswith(("/", "@")):
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        # A service manager that has gone must not end the server.
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as to:
            to.setblocking(False)
            to.sendto("\n".join(states).encode(), address)

    def tell_reloading(self) -> None:
        """Say that a reload has begun; `READY=1` ends it."""
        self.tell("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")

    @property
    def expects_sign(self) -> bool:
        """Whether the watchdog's next sign of life is due."""
        return self._period_s > 0 and time.monotonic() >= self._next

    def give_sign(self) -> None:
        """Send the watchdog a sign of life."""
        self._next = time.monotonic() + self._period_s
        self.tell("WATCHDOG=1")
