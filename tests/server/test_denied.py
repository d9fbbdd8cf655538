"""A query that nobody answers: no server, not allowed, or a lost connection, each told apart."""

import asyncio
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray

import taxel
from taxel.errors import PermissionDenied, ServerLost, Unavailable
from taxel_server.engine import Engine

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]


@contextmanager
def router(listen: str, server: str, *denied: dict[str, Any]) -> Iterator[None]:
    """A zenoh router in front of a server. Its access control denies all clients some messages."""
    rules = [{"id": str(number), "permission": "deny"} | rule for number, rule in enumerate(denied)]
    subjects = [{"id": "clients", "link_protocols": ["tcp"]}]
    policies = [{"rules": [rule["id"] for rule in rules], "subjects": ["clients"]}]
    config = zenoh.Config()
    for key, value in {
        "mode": "router",
        "scouting/multicast/enabled": False,
        "scouting/delay": 0,
        "listen/endpoints": [listen],
        "connect/endpoints": [server],
        "access_control": {
            "enabled": True,
            "default_permission": "allow",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        },
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        wait_for_keys(session, "taxel")
        while not (tokens := [reply.ok for reply in session.liveliness().get("taxel/@replica/*")]):
            pass
        # Right behind a router, keys become known one after the other: the server's own ones last.
        wait_for_keys(session, str(tokens[0].key_expr))
        yield


def wait_for_keys(session: zenoh.Session, prefix: str) -> None:
    with session.declare_querier(f"{prefix}/**") as querier:
        found: Any = querier
        while not found.matching_status.matching:
            pass


def test_a_denied_query_is_told_from_a_server_that_is_not_there(
    engine: Engine, start: ServerStarter, endpoint: str, make_windows: WindowMaker
) -> None:
    keys = ["taxel/v2/models/skin/**", "taxel/@replica/*/v2/models/skin/**"]
    denied = {"messages": ["query"], "flows": ["ingress"], "key_exprs": keys}
    windows = make_windows(1)

    async def asynchronous() -> None:
        async with taxel.connect_async(endpoint, transport="zenoh") as source:
            assert (await source.models())[0].name == "skin"
            with pytest.raises(PermissionDenied, match="gets no answer"):
                await source.predictor("skin")

    with router(endpoint, start(engine), denied):
        with taxel.connect(endpoint, transport="zenoh") as source:
            assert source.ready()
            assert source.predictor("wide").predict(make_windows(1, 12)).shape == (1, 21)
            with pytest.raises(PermissionDenied, match=f"{endpoint}: a server is there, but"):
                source.predictor("skin", "2")
            with pytest.raises(PermissionDenied, match="expected a user, a certificate or a network"):
                source.get("taxel/v2/models/skin/infer", windows.tobytes())
        asyncio.run(asynchronous())
        with (
            taxel.connect(endpoint, transport="zenoh", prefix="other") as stranger,
            pytest.raises(Unavailable, match="nobody answers other/v2") as nobody,
        ):
            stranger.models()
        assert type(nobody.value) is Unavailable


def test_a_server_that_may_not_be_known_of_is_not_there(
    engine: Engine, start: ServerStarter, endpoint: str
) -> None:
    keys = ["**", "taxel/@replica/**"]
    rules = (
        {"messages": ["declare_queryable", "liveliness_token"], "flows": ["egress"], "key_exprs": keys},
        {"messages": ["query"], "flows": ["ingress"], "key_exprs": keys},
    )
    with (
        router(endpoint, start(engine), *rules),
        taxel.connect(endpoint, transport="zenoh") as source,
        pytest.raises(Unavailable, match="that this client may know of"),
    ):
        source.models()


def test_a_lost_connection_is_told_from_a_server_that_is_not_there(
    engine: Engine, start: ServerStarter, endpoint: str, make_windows: WindowMaker
) -> None:
    with router(endpoint, start(engine)):
        source = taxel.connect(endpoint, transport="zenoh")
        predictor = source.predictor("skin")
        assert predictor.predict(make_windows(1)).shape == (1, 21)
    while source.connection.connected:
        pass
    with source, pytest.raises(ServerLost, match="the connection to the server was lost"):
        predictor.predict(make_windows(1), timeout=0.1)
