"""A zenoh router of its own for each test, as a network of rmw_zenoh has."""

import json
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

import taxel
from taxel.predictor import Predictor


def open_zenoh(settings: dict[str, Any]) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in {**settings, "scouting/multicast/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def open_router(endpoint: str) -> zenoh.Session:
    return open_zenoh({"mode": "router", "listen/endpoints": [endpoint], "scouting/delay": 0})


@pytest.fixture
def lost_router() -> Iterator[tuple[str, Callable[[], zenoh.Session]]]:
    """The endpoint of a router, and what ends it and begins another one there."""
    endpoint = free_endpoint()
    routers = [open_router(endpoint)]

    def begin_again() -> zenoh.Session:
        routers.pop().close()  # type: ignore[no-untyped-call]
        routers.append(open_router(endpoint))
        return routers[0]

    yield endpoint, begin_again
    routers.pop().close()  # type: ignore[no-untyped-call]


@pytest.fixture
def router() -> Iterator[str]:
    """The endpoint of a router."""
    endpoint = free_endpoint()
    session = open_router(endpoint)
    yield endpoint
    session.close()  # type: ignore[no-untyped-call]


@pytest.fixture
def session(router: str) -> Iterator[zenoh.Session]:
    """A bare session of the router's network."""
    opened = open_zenoh({"mode": "client", "connect/endpoints": [router]})
    yield opened
    opened.close()  # type: ignore[no-untyped-call]


@pytest.fixture(scope="session")
def predictor() -> Iterator[Predictor]:
    """The shipped xgb model, in this process."""
    with taxel.load() as models:
        yield models.predictor("xgb", "1")
