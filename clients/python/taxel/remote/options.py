"""What `taxel.connect` and `taxel.connect_async` are given: checked before anything is opened."""

import re
from typing import Any, Final, Literal, NamedTuple, Self

from taxel.arguments import checked_flag, checked_timeout
from taxel.endpoints import checked_endpoint
from taxel.errors import InvalidArgument
from taxel.remote.query_transport import QueryTransport
from taxel.remote.zenoh_connection import Connection

Transport = Literal["zenoh", "lane"]
"""A transport that can be asked for by its name."""

_PREFIX: Final = re.compile(r"[A-Za-z0-9._-]+(/[A-Za-z0-9._-]+)*")


class ConnectOptions(NamedTuple):
    """Checked arguments; see `taxel.connect`.

    Attributes:
        transport: opened by the caller; if none, zenoh at the endpoint.
        lane: whether to look for a lane; `only` if windows may go no other way.
    """

    endpoint: str
    timeout: float
    prefix: str
    shared_memory: bool
    transport: QueryTransport | None
    lane: Literal["no", "yes", "only"]

    @classmethod
    def checked(cls, endpoint: Any, timeout: Any, prefix: Any, shared_memory: Any, transport: Any) -> Self:
        """Check the arguments of a connection.

        Raises:
            InvalidArgument: one is wrong; the text names it.
        """
        if not isinstance(prefix, str) or not _PREFIX.fullmatch(prefix):
            raise InvalidArgument(
                f"prefix is {prefix!r}: expected parts of letters, digits, '.', '_' and '-'"
            )
        common = checked_timeout(timeout), prefix, checked_flag("shared_memory", shared_memory)
        if isinstance(transport, QueryTransport):
            if endpoint is not None:
                raise InvalidArgument(f"endpoint is {endpoint!r}: expected none, as a transport is given")
            return cls(transport.endpoint, *common, transport, "no")
        if transport is not None and transport not in ("lane", "zenoh"):
            raise InvalidArgument(
                f"transport is {transport!r}: expected 'lane', 'zenoh' or None, or a QueryTransport"
            )
        lane: dict[Any, Literal["no", "yes", "only"]] = {None: "yes", "lane": "only", "zenoh": "no"}
        return cls(checked_endpoint(endpoint), *common, None, lane[transport])


def open_transport(options: ConnectOptions) -> QueryTransport:
    """What carries the queries; errors as in `taxel.connect`."""
    return options.transport or Connection(
        options.endpoint, options.prefix, options.timeout, shared_memory=options.shared_memory
    )
