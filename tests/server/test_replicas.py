"""Several servers of the same models: requests are spread, and none is lost with a server."""

import asyncio
import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
import trustme
import zenoh
from numpy.typing import NDArray

import taxel
from taxel.errors import InvalidArgument, Unavailable
from taxel.protocol import unpackb
from taxel.remote import RemotePredictor, RemoteSource
from taxel.remote.replicas import Replicas
from taxel_bench.plain_client import client_config
from taxel_bench.server_process import free_port, running_server_process
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.service import Service

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]

PATIENT = 60.0


def served(engine: Engine, place: str) -> Service:
    return Service(engine, ServerOptions(listen=(place,), lane="off")).start()


def replicas_of(source: RemoteSource) -> Replicas:
    assert isinstance(source.connection, Replicas)
    return source.connection


def wait_for(source: RemoteSource, count: int) -> None:
    while len(replicas_of(source).alive()) != count:
        time.sleep(1e-3)


def requests_at(place: str) -> int:
    with taxel.connect(place, transport="zenoh") as source:
        told = unpackb(source.get("taxel/v2/models/skin/stats"))
    counted: int = told["requests"]
    return counted


def ask_until_all_were_asked(
    predictor: RemotePredictor, windows: NDArray[np.float32], places: list[str]
) -> int:
    """How many requests it took; a server whose first answer came late is let alone for a while."""
    asked, ends = 0, time.monotonic() + PATIENT
    while asked < 40 or not all(requests_at(place) for place in places):
        assert time.monotonic() < ends, f"after {asked} requests one of {places} was never asked"
        for _ in range(40):
            assert predictor.predict(windows).shape == (len(windows), 21)
        asked += 40
    return asked


class Asking:
    """Asks in threads of its own until the block ends, and checks each answer."""

    def __init__(self, predictor: RemotePredictor, windows: NDArray[np.float32]) -> None:
        self.answered = 0
        self.errors: list[Exception] = []
        self._ends = False
        self._predictor, self._windows = predictor, windows
        self._honest = predictor.predict(windows)
        self._threads = [Thread(target=self._ask) for _ in range(3)]

    def _ask(self) -> None:
        while not self._ends:
            try:
                np.testing.assert_array_equal(self._predictor.predict(self._windows), self._honest)
            except Exception as error:
                self.errors.append(error)
            self.answered += 1

    def more(self, count: int = 100) -> None:
        """Wait for further answers."""
        wanted = self.answered + count
        while self.answered < wanted:
            time.sleep(1e-3)

    def __enter__(self) -> "Asking":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends = True
        for thread in self._threads:
            thread.join()


def test_requests_are_spread_and_each_is_answered_once(
    engine: Engine, start: ServerStarter, make_windows: WindowMaker
) -> None:
    places = [start(engine, lane="off") for _ in range(3)]
    with taxel.connect(places, timeout=PATIENT) as source:
        assert len(replicas_of(source).alive()) == 3
        predictor = source.predictor("skin", "10")
        asked = ask_until_all_were_asked(predictor, make_windows(1), places)
        assert [each.load.outstanding for each in replicas_of(source).alive()] == [0, 0, 0]
        counted = [requests_at(place) for place in places]
        # On a busy machine a server may seem silent, so that another one is asked, too.
        assert asked <= sum(counted) <= asked + source.retries


def test_servers_that_stop_and_start_lose_no_request(
    engine: Engine, start: ServerStarter, endpoint: str, make_windows: WindowMaker
) -> None:
    """A rolling restart of two servers, one of which is not there when the client connects."""
    other = start(engine, lane="off")
    with taxel.connect([endpoint, other], timeout=PATIENT) as source:
        assert source.connection.connected
        assert len(replicas_of(source).alive()) == 1
        with Asking(source.predictor("skin"), make_windows(2)) as asking:
            for _ in range(2):
                service = served(engine, endpoint)
                wait_for(source, 2)
                asking.more()
                service.close()
                wait_for(source, 1)
                asking.more()
        assert asking.errors == []


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs signals that stop a process")
def test_servers_that_are_stopped_or_killed_lose_no_request(
    repository: Path, make_windows: WindowMaker
) -> None:
    with ExitStack() as stack:
        first, second = (
            stack.enter_context(running_server_process(repository, "--lane", "off")) for _ in range(2)
        )
        source = stack.enter_context(taxel.connect([first.endpoint, second.endpoint], timeout=PATIENT))
        with Asking(source.predictor("skin"), make_windows(2)) as asking:
            asking.more()
            os.kill(first.pid, signal.SIGSTOP)
            asking.more()
            os.kill(first.pid, signal.SIGCONT)
            asking.more()
            os.kill(first.pid, signal.SIGKILL)
            wait_for(source, 1)
            asking.more()
        assert asking.errors == []

        async def asynchronous() -> None:
            async with taxel.connect_async([first.endpoint, second.endpoint]) as awaited:
                predictor = await awaited.predictor("skin")
                told = await asyncio.gather(*(predictor.predict(make_windows(1)) for _ in range(40)))
                assert {each.shape for each in told} == {(1, 21)}

        asyncio.run(asynchronous())


def test_where_no_server_is_there_it_is_told(endpoint: str) -> None:
    with pytest.raises(Unavailable, match="no server at"):
        taxel.connect([endpoint, endpoint.replace("127.0.0.1", "localhost")], timeout=0.3)


def test_the_last_server_that_ends_is_told(
    engine: Engine, endpoint: str, make_windows: WindowMaker
) -> None:
    service = served(engine, endpoint)
    nobody = endpoint.replace("127.0.0.1", "localhost").replace("tcp/", "udp/")
    with taxel.connect([endpoint, nobody], timeout=1.0) as source:
        predictor = source.predictor("skin")
        service.close()
        with pytest.raises(Unavailable):
            predictor.predict(make_windows(1), timeout=0.3)
        assert not source.ready()


def test_a_lane_leads_to_one_server(endpoint: str) -> None:
    with pytest.raises(InvalidArgument, match="a lane leads to one server"):
        taxel.connect([endpoint, "tcp/127.0.0.1:1"], transport="lane")


@contextmanager
def router(listen: str, servers: list[str], **settings: str) -> Iterator[None]:
    """A zenoh router that dials servers; settings are JSON5."""
    config = zenoh.Config()
    for key, value in {
        "mode": "router",
        "scouting/multicast/enabled": False,
        "scouting/delay": 0,
        "listen/endpoints": [listen],
        "connect/endpoints": servers,
    }.items():
        config.insert_json5(key, json.dumps(value))
    for key, text in settings.items():
        config.insert_json5(key.replace("__", "/"), text)
    with zenoh.open(config) as session:
        found: list[Any] = []
        while len(found) < len(servers):
            found = list(session.liveliness().get("taxel/@replica/*"))
        yield


def test_servers_behind_a_router_are_found_and_asked(
    engine: Engine, start: ServerStarter, endpoint: str, make_windows: WindowMaker
) -> None:
    places = [start(engine, lane="off") for _ in range(2)]
    with router(endpoint, places), taxel.connect(endpoint, timeout=PATIENT) as source:
        wait_for(source, 2)
        predictor = source.predictor("skin")
        assert predictor.transport == "zenoh"
        ask_until_all_were_asked(predictor, make_windows(1), places)


def test_behind_a_router_with_the_documented_access_control_nobody_else_answers(
    engine: Engine, endpoint: str, tmp_path: Path, make_windows: WindowMaker
) -> None:
    page = (Path(__file__).parents[2] / "docs" / "security.md").read_text()
    access = page.partition("```json5\n")[2].partition("```")[0]
    authority = trustme.CA()
    authority.cert_pem.write_to_path(str(tmp_path / "ca.pem"))
    issued = authority.issue_cert("127.0.0.1", common_name="taxel")
    issued.cert_chain_pems[0].write_to_path(str(tmp_path / "server.pem"))
    issued.private_key_pem.write_to_path(str(tmp_path / "server.key"))
    place = f"tls/127.0.0.1:{free_port()}"
    certificate, key = tmp_path / "server.pem", tmp_path / "server.key"
    options = ServerOptions(listen=(place,), tls_certificate=certificate, tls_key=key)
    service = Service(engine, options).start()
    trust = json.dumps({"root_ca_certificate": str(tmp_path / "ca.pem")})
    with (
        router(endpoint, [place], access_control=access, transport__link__tls=trust),
        zenoh.open(client_config(endpoint)) as forger,
        taxel.connect(endpoint, timeout=PATIENT) as source,
    ):
        own = f"taxel/@replica/{forger.info.zid()}"
        asked: list[str] = []
        for keys in ("taxel/**", "**", f"{own}/**"):
            forger.declare_queryable(keys, lambda query: asked.append(str(query.key_expr)), complete=True)
        forger.liveliness().declare_token(own)
        # The router has taken the declarations once it has answered what was sent after them.
        assert list(forger.liveliness().get("taxel/@replica/*"))
        predictor = source.predictor("skin")
        for _ in range(20):
            assert predictor.predict(make_windows(1)).shape == (1, 21)
        assert len(replicas_of(source).alive()) == 1
        assert asked == []
    service.close()
