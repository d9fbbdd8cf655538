"""How sessions of zenoh begin and end: only in the process that opened the first one, and within a second.

zenoh's threads do not exist in a process that was forked later. There, a query, a new session, and even
the end of a session would wait forever.
"""

import ctypes
import os
from contextlib import suppress
from threading import Thread
from typing import Final, Protocol
from weakref import WeakSet

import zenoh

from taxel.errors import Unavailable
from taxel.lingering import end_without_lingering

AFTER_FORK: Final = (
    "connections do not survive a fork: start processes with multiprocessing's 'spawn' or 'forkserver', "
    "and connect in each of them; or connect only after the fork, and in no process before it"
)
"""What to do in a process that was forked from one with a session."""


SIGNAL_CHECK_S: Final = 0.1
"""A main thread that waits must wake so often: the kernel may give Ctrl-C to one of zenoh's threads, which
does not wake it."""


class HoldsSessions(Protocol):
    """Has zenoh's objects that must not end in a forked process."""

    def zenoh_objects(self) -> list[object]:
        """The session, and what was declared on it."""


_HOLDERS: Final[WeakSet[HoldsSessions]] = WeakSet()
_first_process: int | None = None
"""The process that opened the first session: an ancestor, if this process was forked."""


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session.

    Raises:
        Unavailable: this process was forked from one that has opened a session.
        zenoh.ZError: the session cannot be opened.
    """
    global _first_process
    if _first_process not in (None, os.getpid()):
        raise Unavailable(
            f"process {_first_process} used zenoh before it forked this process: {AFTER_FORK}"
        )
    _first_process = os.getpid()
    session = zenoh.open(config)
    end_without_lingering(session)
    return session


def close_session(session: zenoh.Session, *, patience_s: float = 1.0) -> bool:
    """Close a session, or leave it behind where zenoh does not come to an end.

    It waits ten seconds for another end that has stopped reading, and then raises an error
    (eclipse-zenoh/zenoh#2675), or waits forever where that end leaves at the same time (#969).

    Returns:
        False if the session was left behind.
    """

    def close() -> None:
        with suppress(zenoh.ZError):  # It is gone, or no longer ours to end.
            session.close()  # type: ignore[no-untyped-call]

    farewell = Thread(target=close, name="taxel-farewell", daemon=True)
    try:
        farewell.start()
    except RuntimeError:  # The interpreter is ending: from Python 3.12 on, it starts no thread any more.
        close()
        return True
    farewell.join(patience_s)
    return not farewell.is_alive()


def leave_behind_after_fork(holder: HoldsSessions) -> None:
    """In processes that are forked later, leave zenoh's objects of this holder as they are."""
    _HOLDERS.add(holder)


def _leave_behind() -> None:
    for holder in _HOLDERS:
        for item in holder.zenoh_objects():
            # One reference that is never given back: zenoh's end of the object would wait forever.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(item))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_behind)
