"""The lane's frames: what one end writes, the other reads; what is none is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from taxel.errors import Internal, InvalidArgument, RequestError, ResourceExhausted
from taxel.lane import frames
from taxel.protocol import InferResponse

windows = hnp.arrays(np.float32, st.tuples(st.integers(1, 5), st.integers(1, 7)))
outputs = st.integers(1, 5).flatmap(lambda rows: hnp.arrays(np.float32, (rows, 21)))
ids = st.integers(0, 2**32 - 1)
PATH = "v2/models/skin/infer"


def frame(values: NDArray[np.float32], path: str = PATH) -> bytes:
    return frames.pack_request_head(path, 7, values.shape, 250.0, spread=False) + values.tobytes()


@given(windows, st.text(max_size=40), ids, st.floats(0, 1e9), st.booleans(), st.binary(max_size=8))
def test_a_request_is_read_as_it_was_written(
    values: NDArray[np.float32], path: str, number: int, timeout_ms: float, spread: bool, before: bytes
) -> None:
    whole = frames.pack_request_head(path, number, values.shape, timeout_ms, spread=spread)
    whole += values.tobytes()
    head = frames.read_request_head(before + whole, len(before))
    assert (head.size, head.spread, head.id) == (len(whole), spread, number)
    assert (head.rows, head.columns, head.timeout_ms) == (*values.shape, timeout_ms)
    assert whole[frames.HEAD_BYTES :][: head.path_bytes].decode() == path
    assert whole[head.data_at :] == values.tobytes()
    assert len(whole) % 4 == head.data_at % 4 == 0


@given(outputs, st.booleans(), ids, st.tuples(ids, ids, ids))
def test_predictions_are_read_as_they_were_written(
    counts: NDArray[np.float32], spread: bool, number: int, times: tuple[int, int, int]
) -> None:
    queue_us, compute_us, batch_rows = times
    response = InferResponse(
        counts, "skin", "1", None, queue_us, compute_us, batch_rows, -counts if spread else None
    )
    whole = frames.pack_reply(number, response)
    head = frames.read_reply_head(whole)
    assert head == (len(whole), frames.PREDICTIONS, spread, number, len(counts), batch_rows, *times[:2])
    read = frames.read_counts(whole[frames.HEAD_BYTES :], head)
    for got, expected in zip(read, [counts, -counts] if spread else [counts], strict=True):
        assert got.tobytes() == expected.tobytes()


@given(st.text(max_size=100), ids)
def test_an_error_is_read_as_it_was_written(text: str, number: int) -> None:
    whole = frames.pack_reply(number, ResourceExhausted(text))
    head = frames.read_reply_head(whole)
    assert (head.size, head.kind, head.id) == (len(whole), frames.ERROR, number)
    error = frames.read_error(whole[frames.HEAD_BYTES :])
    assert type(error) is ResourceExhausted
    assert str(error) == text
    with pytest.raises(ResourceExhausted):
        frames.read_counts(whole[frames.HEAD_BYTES :], head)


@given(st.binary(min_size=32, max_size=32))
def test_random_bytes_are_no_head(data: bytes) -> None:
    with pytest.raises(InvalidArgument):
        frames.read_request_head(data, 0)
    with pytest.raises(Internal):
        frames.read_reply_head(data)


@given(st.integers(0, 31), st.integers(1, 255))
def test_a_flipped_byte_of_a_head_never_changes_where_a_frame_ends_unseen(place: int, flip: int) -> None:
    whole = bytearray(frame(np.zeros((2, 6), np.float32)))
    good = frames.read_request_head(bytes(whole), 0)
    whole[place] ^= flip
    try:
        head = frames.read_request_head(bytes(whole), 0)
    except RequestError:
        return
    assert head.size == head.data_at + head.rows * head.columns * 4
    assert head.size == good.size or place in range(4, 8)
