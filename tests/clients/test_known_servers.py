"""Which servers a client knows of, and what it makes of those that it has lost sight of."""

import time
from collections.abc import Callable

import pytest

from taxel.errors import ServerLost, Unavailable
from taxel.protocol import REPLICAS
from taxel.remote.credentials import Credentials
from taxel.remote.known_servers import KnownServers
from taxel.remote.zenoh_connection import Connection
from taxel.remote.zenoh_opening import open_client_session
from taxel_bench.server_process import free_port
from taxel_server.transports.zenoh_session import open_session


def until(holds: Callable[[], bool]) -> None:
    ends = time.monotonic() + 10
    while not holds():
        assert time.monotonic() < ends
        time.sleep(0.01)


def test_a_server_that_was_there_is_lost_until_its_keys_are_known_again() -> None:
    place = f"tcp/127.0.0.1:{free_port()}"
    with open_session([place]) as server:
        own = f"taxel/{REPLICAS}/{server.info.zid()}"
        token = server.liveliness().declare_token(own)
        source = Connection(place, "taxel", 10.0)
        assert source.connected
        token.undeclare()  # type: ignore[no-untyped-call]
        # As after a connection that zenoh has made again: the keys come a little later.
        until(lambda: not source.connected)
        with pytest.raises(ServerLost, match="the connection to the server was lost"):
            source.start("taxel/v2", None, 5.0)()
        token = server.liveliness().declare_token(own)
        until(lambda: source.connected)
        with pytest.raises(Unavailable, match="nobody answers taxel/v2") as unanswered:
            source.start("taxel/v2", None, 5.0)()
        assert not isinstance(unanswered.value, ServerLost)
        source.close()


def test_a_server_whose_keys_were_missed_is_looked_for_again() -> None:
    place = f"tcp/127.0.0.1:{free_port()}"
    with (
        open_session([place]) as server,
        open_client_session(place, 5.0, 5.0, shared_memory=False, credentials=Credentials()) as client,
    ):
        own = str(server.info.zid())
        token = server.liveliness().declare_token(f"taxel/{REPLICAS}/{own}")
        known = KnownServers(client, "taxel")
        assert known.current() == {own}
        # As zenoh leaves it, now and then, where a connection ends while the next one begins.
        known.alive.clear()
        until(lambda: not known.gone)
        assert known.current() == {own}
        token.undeclare()  # type: ignore[no-untyped-call]
        until(lambda: known.gone)
