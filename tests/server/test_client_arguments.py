"""Arguments of a wrong type or value: a typed error at once, never another exception."""

import asyncio
import copy
import pickle
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import taxel
from taxel.endpoints import checked_endpoint
from taxel.errors import InvalidArgument, TaxelError
from taxel.remote import RemoteSource
from taxel.remote.credentials import Credentials
from taxel.remote.options import ConnectOptions
from taxel_server.transports.memory import MemoryServer

WRONG_ENDPOINTS = [
    ("http://127.0.0.1:7447", "perhaps tcp/127.0.0.1:7447"),
    ("tcp://127.0.0.1:7447", "perhaps tcp/127.0.0.1:7447"),
    ("127.0.0.1:7447", "expected PROTOCOL/ADDRESS"),
    ("tcp/127.0.0.1", "expected HOST:PORT"),
    ("tcp/:7447", "expected HOST:PORT"),
    ("tcp/::1:7447", r"\[ADDRESS\]:PORT"),
    ("tcp/localhost:", "expected a port"),
    ("tcp/localhost:http", "expected a port"),
    ("tcp/localhost:0", "expected a port"),
    ("tcp/localhost:65536", "expected a port"),
    ("ssl/localhost:7447", "unknown protocol 'ssl'"),
    ("unixsock-stream/", "expected PROTOCOL/ADDRESS"),
    (b"tcp/localhost:7447", "expected PROTOCOL/ADDRESS"),
    (None, "expected PROTOCOL/ADDRESS"),
]


@pytest.mark.parametrize(("endpoint", "text"), WRONG_ENDPOINTS)
def test_a_wrong_endpoint_is_told(endpoint: Any, text: str) -> None:
    for connect in (taxel.connect, taxel.connect_async):
        with pytest.raises(InvalidArgument, match=text):
            connect(endpoint)


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/[::1]:7447", "tls/robot.local:1?a=b#c=d", "udp/1.2.3.4:65535#iface=lo", "unixsock-stream//tmp/x"],
)
def test_what_zenoh_takes_is_an_endpoint(endpoint: str) -> None:
    assert checked_endpoint(endpoint) == endpoint


@pytest.mark.parametrize("value", [-1, 0.5, "1", None, True, 100_001])
def test_microseconds_are_whole_numbers(value: Any) -> None:
    with pytest.raises(InvalidArgument, match="spin_us is"):
        taxel.connect("tcp/127.0.0.1:7447", spin_us=value)


ANYTHING = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.binary(max_size=8),
    st.lists(st.integers(), max_size=3),
    st.just(object()),
    st.just(1j),
)


@given(
    name=st.sampled_from(["endpoint", "timeout", "prefix", "shared_memory", "credentials", "transport"]),
    value=ANYTHING,
)
def test_anything_as_an_argument_of_connect_is_a_typed_error(name: str, value: Any) -> None:
    right = {
        "endpoint": "tcp/127.0.0.1:7447",
        "timeout": 1,
        "prefix": "taxel",
        "shared_memory": False,
        "credentials": None,
        "transport": None,
    }
    with suppress(InvalidArgument):
        options = ConnectOptions.checked(**(right | {name: value}))
        kinds = [type(each) for each in options]
        assert kinds == [tuple, float, str, bool, Credentials, type(None), str]


@given(
    call=st.sampled_from(
        ["windows", "timeout", "timing", "spread", "name", "version", "rate_hz", "fingers", "key"]
    ),
    value=ANYTHING,
)
@example(call="rate_hz", value=10**400)
@example(call="rate_hz", value=5e-324)
def test_anything_as_an_argument_of_a_predictor_is_a_typed_error(
    memory: RemoteSource, call: str, value: Any
) -> None:
    predictor: Any = memory.predictor("skin")
    source: Any = memory
    windows = np.zeros((1, 6), np.float32)
    calls: dict[str, Callable[[], Any]] = {
        "windows": lambda: predictor.predict(value),
        "timeout": lambda: predictor.predict(windows, timeout=value),
        "timing": lambda: predictor.predict(windows, timing=value),
        "spread": lambda: predictor.infer(windows, spread=value),
        "name": lambda: source.predictor(value),
        "version": lambda: source.predictor("skin", value),
        "rate_hz": lambda: predictor.stream(rate_hz=value),
        "fingers": lambda: predictor.stream(fingers=value) if type(value) is not int or value < 9 else None,
        "key": lambda: source.get(value),
    }
    with suppress(TaxelError):
        calls[call]()


def test_load_wants_a_path() -> None:
    with pytest.raises(InvalidArgument, match="repository is 5"):
        taxel.load(5)  # type: ignore[arg-type]


def test_sources_and_predictors_stay_in_their_process(
    memory: RemoteSource, memory_server: MemoryServer, repository: Path
) -> None:
    async def asynchronous() -> list[Any]:
        async with taxel.connect_async(transport=memory_server) as source:
            return [source, await source.predictor("skin")]

    with taxel.load(repository) as local:
        kept = [memory, local, memory.predictor("skin"), local.predictor("skin")]
        for each in [*kept, *asyncio.run(asynchronous())]:
            for copied in (pickle.dumps, copy.copy):
                with pytest.raises(InvalidArgument, match=r"open them there with taxel\.connect"):
                    copied(each)
