"""Requests that are decoded by a known envelope say what they say."""

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from taxel import envelopes
from taxel.envelopes import RequestReader, RequestWriter
from taxel.errors import InvalidArgument, RequestError, ResourceExhausted
from taxel.protocol import InferRequest, pack_infer_request, unpack_infer_request

MAX_ROWS = 40

floats32 = hnp.arrays(
    np.float32,
    st.tuples(st.integers(1, 3), st.integers(1, 2)),
    elements=st.sampled_from([0.0, 1.0, -1.0, np.nan, np.inf]) | st.floats(width=32),
)
requests = st.builds(
    pack_infer_request,
    floats32,
    timeout_ms=st.sampled_from([None, 5.0, 5000.0]),
    request_id=st.sampled_from([None, "a"]),
    spread=st.booleans(),
)


def outcome(request: InferRequest) -> tuple[Any, ...]:
    return (request.windows.shape, request.windows.tobytes(), *request[1:])


def decoded(payload: bytes) -> tuple[Any, ...] | str:
    try:
        return outcome(unpack_infer_request(payload, MAX_ROWS))
    except RequestError as error:
        return str(error)


def read(reader: RequestReader, payload: bytes) -> tuple[Any, ...] | str:
    try:
        return outcome(reader.read(payload))
    except RequestError as error:
        return str(error)


@given(st.lists(st.tuples(floats32, st.sampled_from([5.0, 5000.0]), st.booleans()), max_size=30))
def test_a_writer_writes_what_encoding_gives(
    asked: list[tuple[NDArray[np.float32], float, bool]],
) -> None:
    writer = RequestWriter()
    for windows, timeout_ms, spread in asked * 2:
        written = writer.write(windows, timeout_ms, spread=spread)
        assert written == pack_infer_request(windows, timeout_ms=timeout_ms, spread=spread)


@given(st.lists(requests, min_size=1, max_size=30))
def test_a_reader_says_what_decoding_says(payloads: list[bytes]) -> None:
    reader = RequestReader(MAX_ROWS)
    for payload in payloads * 2:
        assert read(reader, payload) == decoded(payload)


@given(floats32, st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), max_size=4))
def test_so_it_does_of_bytes_that_look_alike(
    windows: NDArray[np.float32], changes: list[tuple[int, int]]
) -> None:
    reader = RequestReader(MAX_ROWS)
    whole = pack_infer_request(windows, timeout_ms=250.0)
    reader.read(whole)
    changed = bytearray(whole)
    for place, byte in changes:
        changed[place % len(whole)] = byte
    for payload in (bytes(changed), whole, bytes(changed)):
        assert read(reader, payload) == decoded(payload)


def test_a_known_envelope_is_not_decoded_again(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = RequestReader(MAX_ROWS)
    windows = np.arange(24, dtype=np.float32).reshape(2, 12)
    reader.read(pack_infer_request(windows, timeout_ms=5.0))

    def refuse(payload: bytes, max_rows: int) -> InferRequest:
        raise AssertionError

    monkeypatch.setattr(envelopes, "unpack_infer_request", refuse)
    again = reader.read(pack_infer_request(-windows, timeout_ms=5.0))
    np.testing.assert_array_equal(again.windows, -windows)
    assert (again.id, again.timeout_ms, again.spread) == (None, 5.0, False)
    with pytest.raises(AssertionError):
        reader.read(pack_infer_request(windows, timeout_ms=6.0))


def test_numbers_that_stand_twice_in_a_request_are_read_from_their_place() -> None:
    tensor = {"name": "window", "datatype": "FP32", "shape": [1, 2]}

    def twice(beside: bytes, data: bytes) -> bytes:
        return msgpack.packb({"beside": beside, "inputs": [{**tensor, "data": data}]})

    reader = RequestReader(MAX_ROWS)
    for beside, data in (
        (b"01234567", b"01234567"),
        (b"01234567", b"76543210"),
        (b"76543210", b"01234567"),
    ):
        assert reader.read(twice(beside, data)).windows.tobytes() == data


def test_what_is_refused_is_refused_again() -> None:
    reader = RequestReader(2)
    reader.read(pack_infer_request(np.zeros((2, 3), np.float32)))
    for _ in range(2):
        with pytest.raises(ResourceExhausted):
            reader.read(pack_infer_request(np.zeros((3, 2), np.float32)))
        with pytest.raises(InvalidArgument):
            reader.read(b"")


def test_only_so_many_envelopes_are_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(envelopes, "_MOST_KNOWN", 3)
    reader = RequestReader(MAX_ROWS)
    windows = np.ones((1, 12), np.float32)
    for timeout in range(1, 9):
        for sign in (1, -1):
            request = reader.read(pack_infer_request(sign * windows, timeout_ms=float(timeout)))
            assert request.timeout_ms == timeout
            np.testing.assert_array_equal(request.windows, sign * windows)
    assert len(reader._known) == 3
