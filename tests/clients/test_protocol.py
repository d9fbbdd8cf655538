"""The wire format: what goes in comes out, and whatever else comes in is a typed error."""

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from taxel import errors
from taxel.errors import Internal, InvalidArgument, RequestError, ResourceExhausted
from taxel.protocol import (
    InferResponse,
    model_key,
    pack_error,
    pack_infer_request,
    pack_infer_response,
    unpack_error,
    unpack_infer_request,
    unpack_infer_response,
)

floats32 = hnp.arrays(
    np.float32,
    st.tuples(st.integers(1, 20), st.integers(1, 80)),
    elements=st.floats(width=32, allow_nan=True, allow_infinity=True),
)
ids = st.none() | st.text(max_size=20)
json_like = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=30),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                ["inputs", "name", "datatype", "shape", "data", "id", "parameters", "timeout_ms"]
            ),
            inner,
        )
    ),
    max_leaves=20,
)


def request(**changes: Any) -> bytes:
    """A valid request for two rows of six values, with parts of its tensor replaced."""
    tensor = {"name": "window", "datatype": "FP32", "shape": [2, 6], "data": bytes(48), **changes}
    return msgpack.packb({"inputs": [tensor]})


@given(floats32, ids, st.none() | st.floats(0.001, 1e6))
def test_requests_survive_the_wire(
    windows: NDArray[np.float32], request_id: str | None, timeout_ms: float | None
) -> None:
    packed = pack_infer_request(windows, request_id=request_id, timeout_ms=timeout_ms)
    decoded = unpack_infer_request(packed)
    assert decoded.windows.tobytes() == windows.tobytes()
    assert decoded.windows.shape == windows.shape
    assert (decoded.id, decoded.timeout_ms) == (request_id, timeout_ms)


@given(
    hnp.arrays(np.float32, st.tuples(st.integers(1, 20), st.just(21)), elements=st.floats(width=32)), ids
)
def test_responses_survive_the_wire(outputs: NDArray[np.float32], request_id: str | None) -> None:
    response = InferResponse(outputs, "xgb", "3", request_id, 12, 34, 56)
    decoded = unpack_infer_response(pack_infer_response(response))
    assert decoded.outputs.tobytes() == outputs.tobytes()
    assert (decoded.model_name, decoded.model_version, decoded.id) == ("xgb", "3", request_id)
    assert (decoded.queue_us, decoded.compute_us, decoded.batch_rows) == (12, 34, 56)


@given(st.binary(max_size=200))
def test_random_bytes_are_refused_or_decoded_but_never_crash(payload: bytes) -> None:
    with pytest.raises(RequestError):
        unpack_infer_request(payload)


@given(json_like)
def test_random_structures_are_refused_but_never_crash(value: Any) -> None:
    try:
        payload = msgpack.packb(value)
    except (OverflowError, ValueError):
        return
    with pytest.raises(RequestError):
        unpack_infer_request(payload)
    with pytest.raises(Internal):
        unpack_infer_response(payload)
    assert isinstance(unpack_error(payload), RequestError)


@given(st.integers(0, 10_000))
def test_truncated_requests_are_refused(cut: int) -> None:
    whole = pack_infer_request(np.zeros((30, 12), np.float32))
    with pytest.raises(InvalidArgument, match="payload"):
        unpack_infer_request(whole[: cut % len(whole)])


@pytest.mark.parametrize(
    ("payload", "error", "message"),
    [
        (msgpack.packb([]), InvalidArgument, "request: a list: expected a map"),
        (msgpack.packb({}), InvalidArgument, "inputs: missing"),
        (msgpack.packb({"inputs": []}), InvalidArgument, "inputs: a list: expected a list of one tensor"),
        (request(name="pixels"), InvalidArgument, r"inputs\[0\].name: 'pixels': expected 'window'"),
        (request(datatype="FP64"), InvalidArgument, r"inputs\[0\].datatype: 'FP64': expected 'FP32'"),
        (request(shape=[12]), InvalidArgument, r"inputs\[0\].shape: \[12\]: expected \[n, f\]"),
        (request(shape=[True, 6]), InvalidArgument, r"inputs\[0\].shape"),
        (request(shape=[0, 6], data=b""), InvalidArgument, r"inputs\[0\].shape: .*at least one row"),
        (request(shape=[-1, 6]), InvalidArgument, r"inputs\[0\].shape"),
        (
            request(shape=[1_000_000, 6]),
            ResourceExhausted,
            r"inputs\[0\].shape: 1000000 rows: expected at most",
        ),
        (request(data=[0.0] * 12), InvalidArgument, r"inputs\[0\].data: a list: expected bytes"),
        (request(data=bytes(47)), InvalidArgument, r"inputs\[0\].data: 47 bytes: expected 48"),
        (msgpack.packb({"id": 7, "inputs": []}), InvalidArgument, "id: a int: expected text"),
    ],
)
def test_a_bad_request_is_named(payload: bytes, error: type[RequestError], message: str) -> None:
    with pytest.raises(error, match=message):
        unpack_infer_request(payload)


@pytest.mark.parametrize("told", [0, 7, None])
def test_a_full_queue_tells_how_many_requests_it_holds(told: int | None) -> None:
    back = unpack_error(pack_error(ResourceExhausted("the queue is full", told)))
    assert isinstance(back, ResourceExhausted)
    assert (str(back), back.open_requests) == ("the queue is full", told)


@pytest.mark.parametrize("open_requests", [True, 2.5, "7", None, []])
def test_a_number_of_requests_that_is_none_is_not_taken(open_requests: object) -> None:
    told = {"error": "the queue is full", "code": "RESOURCE_EXHAUSTED", "open": open_requests}
    back = unpack_error(msgpack.packb(told))
    assert isinstance(back, ResourceExhausted)
    assert back.open_requests is None


@pytest.mark.parametrize("timeout", [0, -1, "soon", True, float("nan"), float("inf")])
def test_a_bad_timeout_is_named(timeout: object) -> None:
    good = msgpack.unpackb(request())
    with pytest.raises(InvalidArgument, match=r"parameters\.timeout_ms"):
        unpack_infer_request(msgpack.packb({**good, "parameters": {"timeout_ms": timeout}}))


@pytest.mark.parametrize("code", errors._BY_CODE)
def test_an_error_crosses_the_wire_as_itself(code: str) -> None:
    error = errors.from_code(code, "what was wrong")
    received = unpack_error(pack_error(error))
    assert type(received) is type(error)
    assert str(received) == "what was wrong"


def test_an_unknown_error_code_is_internal_and_says_so() -> None:
    received = unpack_error(msgpack.packb({"error": "odd", "code": "TEAPOT"}))
    assert isinstance(received, Internal)
    assert "odd" in str(received)
    assert "TEAPOT" in str(received)


def test_keys() -> None:
    assert model_key("taxel", "xgb", None) == "taxel/v2/models/xgb"
    assert model_key("taxel", "xgb", "2", "infer") == "taxel/v2/models/xgb/versions/2/infer"
