"""Bad requests: each gets one typed error naming the field, and no other client notices."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import taxel
from taxel.errors import InvalidArgument, RequestError, ResourceExhausted
from taxel.protocol import pack_infer_request
from taxel.remote import RemoteSource
from taxel_server.engine import Engine

WindowMaker = Callable[..., NDArray[np.float32]]

KEY = "taxel/v2/models/skin/infer"


@pytest.fixture(scope="module")
def place(engine: Engine, start_module: Callable[..., str]) -> str:
    return start_module(engine)


@pytest.fixture(scope="module")
def client(place: str) -> Iterator[RemoteSource]:
    with taxel.connect(place) as source:
        yield source


@contextmanager
def good_client(place: str, make_windows: WindowMaker) -> Iterator[None]:
    """Someone who asks for predictions all the while, and gets each of them."""
    finish, answered, wrong = Event(), Event(), []

    def ask() -> None:
        with taxel.connect(place) as source:
            predictor = source.predictor("skin")
            windows = make_windows(3)
            expected = predictor.predict(windows)
            while not finish.is_set():
                try:
                    np.testing.assert_array_equal(predictor.predict(windows), expected)
                except (RequestError, AssertionError) as error:
                    wrong.append(error)
                answered.set()

    thread = Thread(target=ask)
    thread.start()
    assert answered.wait(10)
    try:
        yield
        answered.clear()
        assert answered.wait(10)
    finally:
        finish.set()
        thread.join()
    assert wrong == []


def request(changes: dict[str, Any] | None = None, **tensor: Any) -> bytes:
    """A request for two windows of six, with parts replaced."""
    described = {"name": "window", "datatype": "FP32", "shape": [2, 6], "data": bytes(48), **tensor}
    return msgpack.packb({"inputs": [described], **(changes or {})})


def tensor_of(windows: NDArray[Any]) -> dict[str, Any]:
    return {"shape": list(windows.shape), "data": windows.tobytes()}


GOOD = request()
NAN = np.zeros((2, 6), np.float32)
NAN[1, 3] = np.nan

WRONG = [
    pytest.param(b"", "payload: 0 bytes that are not msgpack", id="nothing"),
    pytest.param(GOOD[:-1], "payload: .*not msgpack", id="truncated"),
    pytest.param(GOOD + b"\x00", "payload: .*not msgpack", id="trailing"),
    pytest.param(b"[1, 2, 3]", "payload", id="text"),
    pytest.param(msgpack.packb([1, 2]), "request: a list: expected a map", id="list"),
    pytest.param(request({"inputs": []}), "inputs: .*expected a list of one tensor", id="no tensor"),
    pytest.param(
        request({"inputs": [3]}), r"inputs\[0\]: a int: expected a map", id="tensor of another kind"
    ),
    pytest.param(request({"id": 7}), "id: a int: expected text", id="id"),
    pytest.param(request({"parameters": {"timeout_ms": -1}}), "parameters.timeout_ms: -1", id="timeout"),
    pytest.param(request(name="image"), r"inputs\[0\].name: 'image': expected 'window'", id="name"),
    pytest.param(request(datatype="FP64"), r"inputs\[0\].datatype: 'FP64': expected 'FP32'", id="datatype"),
    pytest.param(request(shape=[12]), r"inputs\[0\].shape: \[12\]: expected \[n, f\]", id="one axis"),
    pytest.param(request(shape=[-2, -6]), r"inputs\[0\].shape", id="negative"),
    pytest.param(request(shape=[2.0, 6.0]), r"inputs\[0\].shape", id="no whole numbers"),
    pytest.param(
        request(shape=[0, 6], data=b""), r"inputs\[0\].shape: .*at least one row", id="empty batch"
    ),
    pytest.param(request(shape=[3, 6]), r"inputs\[0\].data: 48 bytes: expected 72", id="too little data"),
    pytest.param(request(data=[0.0] * 12), r"inputs\[0\].data: a list: expected bytes", id="list as data"),
    pytest.param(
        request(shape=[3, 4]), r"inputs\[0\].shape: \[3, 4\]: expected \[n, 6\]", id="another width"
    ),
    pytest.param(
        request(**tensor_of(NAN)), r"window\[1, 'fx'\] is nan: expected a finite number", id="NaN"
    ),
    pytest.param(request(**tensor_of(NAN - np.inf)), r"window\[0, 'x'\] is -inf", id="infinity"),
    pytest.param(b"\x91" * 2000, "payload", id="deeply nested"),
    pytest.param(b"\xdd\xff\xff\xff\xff", "payload", id="a list that claims to be huge"),
    pytest.param(b"\xdd\x00\x10\x00\x00" + bytes(2**20), "payload: .*max_array_len", id="a huge list"),
    pytest.param(b"\x9f" + (b"\x9f" + b"\x80" * 15) * 15, "payload: .*64 lists and maps", id="many maps"),
]


@pytest.mark.parametrize(("payload", "text"), WRONG)
def test_a_wrong_request_is_refused_with_its_field(client: RemoteSource, payload: bytes, text: str) -> None:
    with pytest.raises(InvalidArgument, match=text):
        client.get(KEY, payload)


def test_a_missing_payload_is_refused(client: RemoteSource) -> None:
    with pytest.raises(InvalidArgument, match="payload: 0 bytes"):
        client.get(KEY, None)


def test_a_million_rows_are_refused(client: RemoteSource) -> None:
    with pytest.raises(ResourceExhausted, match=r"inputs\[0\].data: .*expected at most 65536 rows"):
        client.get(KEY, pack_infer_request(np.zeros((1_000_000, 6), np.float32)))


def test_a_claim_of_a_million_rows_is_refused(client: RemoteSource) -> None:
    with pytest.raises(ResourceExhausted, match=r"inputs\[0\].shape: 1000000 rows: expected at most 65536"):
        client.get(KEY, request(shape=[1_000_000, 6]))


def test_the_largest_request_is_answered(client: RemoteSource, make_windows: WindowMaker) -> None:
    assert client.predictor("skin").predict(make_windows(65_536)).shape == (65_536, 21)


@given(st.binary(max_size=300))
def test_random_bytes_get_one_typed_error(client: RemoteSource, payload: bytes) -> None:
    with pytest.raises(RequestError) as caught:
        client.get(KEY, payload)
    assert caught.value.code == "INVALID_ARGUMENT"


@given(st.integers(0, len(GOOD) - 1), st.integers(1, 255))
def test_a_flipped_byte_gets_a_prediction_or_a_typed_error(
    client: RemoteSource, place: int, flip: int
) -> None:
    damaged = bytearray(GOOD)
    damaged[place] ^= flip
    outcome = "OK"
    try:
        client.get(KEY, bytes(damaged))
    except RequestError as error:
        outcome = error.code
    assert outcome in {"OK", "INVALID_ARGUMENT", "RESOURCE_EXHAUSTED"}


def test_others_never_notice(client: RemoteSource, place: str, make_windows: WindowMaker) -> None:
    with good_client(place, make_windows):
        for _ in range(10):
            for wrong in WRONG:
                with pytest.raises(InvalidArgument):
                    client.get(KEY, wrong.values[0])
