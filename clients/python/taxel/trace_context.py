"""The W3C trace context of a call: which trace of OpenTelemetry a request belongs to.

See https://www.w3.org/TR/trace-context/#traceparent-header.
"""

import re
from typing import Any, Final

from taxel.errors import InvalidArgument

TRACE_CONTEXT: Final = "trace_context"
"""What servers call it, where they tell what they can, that a request may carry it."""

_TRACEPARENT: Final = re.compile(
    r"(?!ff)[0-9a-f]{2}-(?!0{32})[0-9a-f]{32}-(?!0{16})[0-9a-f]{16}-[0-9a-f]{2}"
)


def checked_traceparent(given: Any) -> str:
    """A `traceparent`: version, trace id, span id and flags.

    Raises:
        InvalidArgument: it is none.
    """
    if not is_traceparent(given):
        raise InvalidArgument(
            f"traceparent is {given!r}: expected a W3C traceparent, such as "
            "'00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01'"
        )
    return str(given)


def is_traceparent(given: Any) -> bool:
    """Whether this is one. A server ignores what is none, as the W3C says."""
    return isinstance(given, str) and _TRACEPARENT.fullmatch(given) is not None


def trace_id_of(traceparent: str | None) -> str | None:
    """The trace's own id, 32 hexadecimal digits."""
    return None if traceparent is None else traceparent[3:35]
