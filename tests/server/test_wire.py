"""The golden messages of docs/wire_golden.md: each end writes these bytes, and reads what was meant."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import taxel
from taxel.administration import Order, pack_version
from taxel.envelopes import RequestReader, RequestWriter
from taxel.errors import InvalidArgument, NotFound
from taxel.lane import frames
from taxel.lane.connection import LaneConnection
from taxel.lane.offer import LaneOffer
from taxel.protocol import (
    InferResponse,
    pack_error,
    pack_infer_request,
    pack_infer_response,
    unpack_error,
    unpack_infer_response,
    unpackb,
)
from taxel.trace_context import checked_traceparent
from taxel_server.engine import Engine

GOLDEN = Path(__file__).resolve().parents[2] / "docs" / "wire"
PATH = "v2/models/skin/infer"
TRACEPARENT = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01"
WINDOWS = np.arange(12, dtype="<f4").reshape(2, 6) / 8
COUNTS = np.arange(42, dtype="<f4").reshape(2, 21) + 2000
RESPONSE = InferResponse(COUNTS, "skin", "10", None, 12, 34, 2)
WITH_SPREAD = RESPONSE._replace(spread=COUNTS / 1000)
SHADOW = Order("load", "skin", "10", shadow=True)
ERROR = NotFound("no model 'skn'; there is: skin, wide")


def lane_request() -> bytes:
    return frames.pack_request_head(PATH, 7, (2, 6), 5000.0, spread=False) + WINDOWS.tobytes()


WRITTEN: dict[str, Callable[[], bytes]] = {
    "lane_request.bin": lane_request,
    "lane_request_traced.bin": lambda: (
        frames.pack_request_head(PATH, 7, (2, 6), 5000.0, spread=False, traceparent=TRACEPARENT)
        + WINDOWS.tobytes()
    ),
    "lane_cancel.bin": lambda: frames.pack_cancel(7),
    "lane_predictions.bin": lambda: frames.pack_reply(7, RESPONSE),
    "lane_predictions_spread.bin": lambda: frames.pack_reply(7, WITH_SPREAD),
    "lane_error.bin": lambda: frames.pack_reply(7, ERROR),
    "zenoh_request.msgpack": lambda: RequestWriter().write(WINDOWS, 5000.0),
    "zenoh_request_spread.msgpack": lambda: RequestWriter().write(WINDOWS, 5000.0, spread=True),
    "zenoh_request_traced.msgpack": lambda: RequestWriter().write(WINDOWS, 5000.0, traceparent=TRACEPARENT),
    "zenoh_predictions.msgpack": lambda: pack_infer_response(RESPONSE),
    "zenoh_predictions_spread.msgpack": lambda: pack_infer_response(WITH_SPREAD),
    "zenoh_error.msgpack": lambda: pack_error(ERROR),
    "zenoh_load.msgpack": SHADOW.payload,
    "zenoh_loaded.msgpack": lambda: pack_version("skin", "10"),
}


def golden(name: str) -> bytes:
    return (GOLDEN / name).read_bytes()


def test_every_golden_message_is_checked_and_named_in_the_specification() -> None:
    assert {file.name for file in GOLDEN.iterdir()} == set(WRITTEN)
    text = "".join(
        (GOLDEN.parent / page).read_text(encoding="utf-8") for page in ("wire.md", "wire_lane.md")
    )
    assert all(f"(wire/{name})" in text for name in WRITTEN)


def test_the_specification_shows_the_bytes_of_every_golden_message() -> None:
    """Each line of its block is bytes in hex, two spaces or more, and what they are."""
    text = (GOLDEN.parent / "wire_golden.md").read_text(encoding="utf-8")
    blocks = re.findall(r"\(wire/([^)]+)\), (\d+) bytes:\n\n```text\n(.*?)```", text, re.DOTALL)
    shown = {name: [line.split("  ", 1)[0] for line in block.splitlines()] for name, _, block in blocks}
    assert {name: "".join(lines) for name, lines in shown.items()} == {
        name: golden(name).hex() for name in WRITTEN
    }
    assert {name: int(size) for name, size, _ in blocks} == {name: len(golden(name)) for name in WRITTEN}


@pytest.mark.parametrize("name", WRITTEN)
def test_its_writer_writes_it(name: str) -> None:
    assert WRITTEN[name]() == golden(name)


def test_a_server_reads_the_requests() -> None:
    head = frames.read_request_head(golden("lane_request.bin"), 0)
    assert head == (len(golden("lane_request.bin")), False, len(PATH), 7, 2, 6, 5000.0, 52, None)
    assert golden("lane_request.bin")[head.data_at :] == WINDOWS.tobytes()
    for name, spread in (("zenoh_request.msgpack", False), ("zenoh_request_spread.msgpack", True)):
        request = RequestReader(10).read(golden(name))
        np.testing.assert_array_equal(request.windows, WINDOWS)
        assert request[1:] == (None, 5000.0, spread, None)


def test_a_server_reads_the_trace_context() -> None:
    frame = golden("lane_request_traced.bin")
    head = frames.read_request_head(frame, 0)
    assert head == (len(frame), False, len(PATH), 7, 2, 6, 5000.0, 52 + 56, TRACEPARENT)
    assert frame[head.data_at :] == WINDOWS.tobytes()
    reader = RequestReader(10)
    for _ in range(2):
        request = reader.read(golden("zenoh_request_traced.msgpack"))
        np.testing.assert_array_equal(request.windows, WINDOWS)
        assert request[1:] == (None, 5000.0, False, TRACEPARENT)


@pytest.mark.parametrize(
    "wrong",
    [
        "",
        TRACEPARENT.upper(),
        TRACEPARENT[:-1],
        TRACEPARENT + "0",
        "ff" + TRACEPARENT[2:],
        TRACEPARENT.replace("00f067aa0ba902b7", "0" * 16),
        TRACEPARENT.replace("4bf92f3577b34da6a3ce929d0e0e4736", "0" * 32),
    ],
)
def test_what_is_no_trace_context_is_ignored_by_servers_and_refused_by_clients(wrong: str) -> None:
    with pytest.raises(InvalidArgument, match="expected a W3C traceparent"):
        checked_traceparent(wrong)
    told = pack_infer_request(WINDOWS, traceparent=wrong)
    assert RequestReader(10).read(told).traceparent is None
    frame = bytearray(golden("lane_request_traced.bin"))
    frame[52 : 52 + 56] = wrong.encode()[:56].ljust(56, b"\0")
    assert frames.read_request_head(bytes(frame), 0).traceparent is None


def test_a_server_reads_the_cancellation() -> None:
    frame = golden("lane_cancel.bin")
    assert (len(frame), frame[frames.KIND_AT]) == (frames.HEAD_BYTES, frames.CANCELLATION)
    assert frames.read_cancel(b"1234" + frame + frame, 4) == 7


def test_a_server_reads_the_order() -> None:
    path = "v2/repository/models/skin/versions/10/load"
    assert SHADOW.path == path
    assert Order.read(path, golden("zenoh_load.msgpack")) == SHADOW
    assert unpackb(golden("zenoh_loaded.msgpack")) == {"name": "skin", "version": "10"}


@pytest.mark.parametrize("suffix", ["", "_spread"])
def test_a_client_reads_the_predictions(suffix: str) -> None:
    frame = golden(f"lane_predictions{suffix}.bin")
    head = frames.read_reply_head(frame)
    assert head == (len(frame), frames.PREDICTIONS, bool(suffix), 7, 2, 2, 12, 34)
    counts = frames.read_counts(frame[frames.HEAD_BYTES :], head)
    read = unpack_infer_response(golden(f"zenoh_predictions{suffix}.msgpack"))
    np.testing.assert_array_equal(counts[0], COUNTS)
    np.testing.assert_array_equal(read.outputs, COUNTS)
    assert read[1:7] == RESPONSE[1:7]
    if suffix:
        np.testing.assert_array_equal(counts[1], COUNTS / np.float32(1000))
        np.testing.assert_array_equal(read.spread, counts[1])


def test_a_client_reads_the_errors() -> None:
    for error in (
        frames.read_error(golden("lane_error.bin")[frames.HEAD_BYTES :]),
        unpack_error(golden("zenoh_error.msgpack")),
    ):
        assert (type(error), str(error)) == (NotFound, str(ERROR))


def test_a_running_server_answers_the_requests(engine: Engine, start: Callable[..., str]) -> None:
    expected = engine.model("skin").evaluate(WINDOWS)
    with taxel.connect(start(engine), transport="zenoh") as source:
        reply = unpack_infer_response(source.get(f"taxel/{PATH}", golden("zenoh_request.msgpack")))
        np.testing.assert_array_equal(reply.outputs, expected)
        offer = LaneOffer.read(unpackb(source.get("taxel/v2")))
    assert offer is not None
    connection = LaneConnection(offer.address)
    connection.socket.sendall(golden("lane_request.bin"))
    head, content = connection.receive(10)
    assert head.id == 7
    np.testing.assert_array_equal(frames.read_counts(content, head)[0], expected)
    connection.close()
