"""The remote client against servers that are absent, silent, gone or talk nonsense."""

import json
import socket
import time
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from typing import Any, Final

import numpy as np
import pytest
import zenoh
from zenoh.handlers import Callback

import taxel
from taxel.channels import CHANNELS
from taxel.errors import (
    DeadlineExceeded,
    Internal,
    InvalidArgument,
    NotFound,
    PermissionDenied,
    RequestError,
    ResourceExhausted,
    ServerLost,
    Unavailable,
)
from taxel.manifest import Manifest, ModelFile, Normalisation, Training, WindowLayout, tensors
from taxel.protocol import REPLICAS, InferResponse, pack_error, pack_infer_response, packb
from taxel.remote import RemotePredictor, RemoteSource
from taxel.remote.remote_model import RemoteModel
from taxel.remote.transport_watch import TransportWatch
from taxel.remote.zenoh_connection import Connection
from taxel_bench.plain_client import client_config

Answer = Callable[[zenoh.Query], None]


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def router_config(endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/delay", "0")
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    return config


@pytest.fixture
def connected() -> Iterator[Callable[[Answer], RemoteSource]]:
    """A client of a server that answers every query with the function given."""
    opened: list[Any] = []

    def connect(answer: Answer) -> RemoteSource:
        endpoint = free_endpoint()
        server = zenoh.open(router_config(endpoint))
        server.declare_queryable("taxel/**", Callback(answer, indirect=False), complete=True)
        client = taxel.connect(endpoint, timeout=10, transport="zenoh")
        opened.extend((server, client))
        return client

    yield connect
    for each in reversed(opened):
        each.close()


def saying(payload: bytes) -> Answer:
    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, payload)

    return answer


def refusing(payload: bytes) -> Answer:
    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply_err(payload)

    return answer


ONE_ROW: Final = pack_infer_response(
    InferResponse(np.ones((1, 21), np.float32), "skin", "1", None, 0, 0, 1)
)
"""The answer to one window."""


def turning_away(query: zenoh.Query) -> None:
    query.drop()


@pytest.fixture
def manifest() -> Manifest:
    spec = taxel.WindowSpec.of(3)
    inputs, outputs = tensors(WindowLayout.of(spec))
    return Manifest(
        name="skin",
        version="1",
        description="",
        platform="xgboost_json",
        inputs=inputs,
        outputs=outputs,
        window=WindowLayout.of(spec),
        normalisation=Normalisation(
            input_mean=(0.0,) * spec.length,
            input_std=(1.0,) * spec.length,
            output_mean=(0.0,) * len(CHANNELS),
            output_std=(1.0,) * len(CHANNELS),
        ),
        parameters=1,
        training=Training(
            family="xgb", data=(), windows={}, split={}, seed=0, hyperparameters={}, metrics={}
        ),
        model_file=ModelFile(name="model.json", sha256="0" * 64, size=1),
        taxel_version=taxel.__version__,
    )


def test_connecting_to_nobody_is_unavailable() -> None:
    endpoint = free_endpoint()
    with pytest.raises(Unavailable, match=f"no server at {endpoint} within 0.1 s") as caught:
        taxel.connect(endpoint, timeout=0.1)
    assert ".rs" not in str(caught.value)


@pytest.mark.parametrize("endpoint", ["", "localhost", "7447"])
def test_what_is_no_endpoint_is_told(endpoint: str) -> None:
    with pytest.raises(InvalidArgument, match=r"expected PROTOCOL/ADDRESS, such as tcp/127\.0\.0\.1:7447"):
        taxel.connect(endpoint)


@pytest.mark.parametrize("timeout", [0, -1, float("nan"), float("inf")])
def test_a_timeout_must_be_above_zero(timeout: float) -> None:
    with pytest.raises(InvalidArgument, match="timeout"):
        taxel.connect("tcp/127.0.0.1:7447", timeout=timeout)


def test_a_query_that_is_dropped_is_denied(connected: Callable[[Answer], RemoteSource]) -> None:
    client = connected(turning_away)
    for ask in (client.models, client.ready):
        with pytest.raises(PermissionDenied, match=r"a server is there, but taxel/v2/.* gets no answer"):
            ask()


def test_a_query_whose_server_went_meanwhile_is_lost_not_denied(
    connected: Callable[[Answer], RemoteSource],
) -> None:
    def going(query: zenoh.Query) -> None:
        token.undeclare()
        assert seen(0)
        query.drop()

    def seen(servers: int) -> bool:
        ends = time.monotonic() + 5
        while len(client.connection.servers()) != servers and time.monotonic() < ends:
            time.sleep(0.001)
        return len(client.connection.servers()) == servers

    client = connected(going)
    with zenoh.open(client_config(client.endpoint)) as other:
        token: Any = other.liveliness().declare_token(f"taxel/{REPLICAS}/another")
        assert seen(1)
        with pytest.raises(
            ServerLost, match="nobody answers taxel/v2: the connection to the server was lost"
        ):
            client.get("taxel/v2")


def test_who_was_answered_before_is_not_denied(connected: Callable[[Answer], RemoteSource]) -> None:
    asked: list[zenoh.Query] = []

    def once(query: zenoh.Query) -> None:
        asked.append(query)
        if len(asked) == 1:
            query.reply(query.key_expr, b"first")
        query.drop()

    client = connected(once)
    assert client.get("taxel/v2/models") == b"first"
    with pytest.raises(ServerLost, match="a server disconnects clients that do not read their answers"):
        client.get("taxel/v2/models")
    with pytest.raises(PermissionDenied):
        client.get("taxel/v2/models/skin")


def test_nothing_is_asked_without_a_transport(
    connected: Callable[[Answer], RemoteSource],
    monkeypatch: pytest.MonkeyPatch,
    outcomes: "SimpleQueue[bytes | RequestError]",
) -> None:
    """The connection may be there again by the time of the error, which still says that it was lost."""
    asked: list[zenoh.Query] = []
    client = connected(asked.append)
    monkeypatch.setattr(TransportWatch, "is_open", False)
    assert client.connection.connected
    with pytest.raises(ServerLost, match="nobody answers taxel/v2: the connection to the server was lost"):
        client.get("taxel/v2", timeout=20)
    client.connection.send("taxel/v2", None, 20.0, outcomes.put)
    assert isinstance(outcomes.get(timeout=5), ServerLost)
    assert asked == []


def test_what_waits_for_an_answer_ends_when_its_transport_closes(
    connected: Callable[[Answer], RemoteSource], outcomes: "SimpleQueue[bytes | RequestError]"
) -> None:
    """zenoh ends most such queries itself, but not those that come as it closes the transport.

    The transport that closes here is another one, so that zenoh has nothing to do with the end.
    """
    held: SimpleQueue[zenoh.Query] = SimpleQueue()
    kept: list[zenoh.Query] = []
    client = connected(held.put)
    connection, lost = client.connection, "nobody answers taxel/v2: the connection to the server was lost"
    assert isinstance(connection, Connection)
    endpoint = free_endpoint()
    with zenoh.open(router_config(endpoint)) as another, zenoh.open(client_config(endpoint)) as ours:
        listener: Any = ours.info.declare_transport_events_listener(
            Callback(connection.watch.note, indirect=False)
        )
        connection.send("taxel/v2", None, 20.0, outcomes.put)
        asked = connection.start("taxel/v2", None, 20.0)
        kept += held.get(timeout=5), held.get(timeout=5)
        another.close()
        with pytest.raises(ServerLost, match=lost):
            asked()
        assert isinstance(outcomes.get(timeout=5), ServerLost)
        listener.undeclare()
    # What is asked later goes over another transport.
    connection.send("taxel/v2", None, 20.0, outcomes.put)
    kept.append(held.get(timeout=5))
    kept[-1].reply(kept[-1].key_expr, b"here")
    assert outcomes.get(timeout=5) == b"here"


def test_what_is_asked_just_as_the_transport_closes_is_lost_at_once(
    connected: Callable[[Answer], RemoteSource],
    monkeypatch: pytest.MonkeyPatch,
    outcomes: "SimpleQueue[bytes | RequestError]",
) -> None:
    def closing(watch: TransportWatch) -> bool:
        """It is there when the client looks, and closes before it sends."""
        watch.end_queries()
        return True

    asked: list[zenoh.Query] = []
    client = connected(asked.append)
    monkeypatch.setattr(TransportWatch, "is_open", property(closing))
    with pytest.raises(ServerLost, match="nobody answers taxel/v2: the connection to the server was lost"):
        client.get("taxel/v2", timeout=20)
    client.connection.send("taxel/v2", None, 20.0, outcomes.put)
    assert isinstance(outcomes.get(timeout=5), ServerLost)
    assert asked == []


def test_windows_are_answered_by_a_connection_that_is_lost_again_and_again(
    connected: Callable[[Answer], RemoteSource], manifest: Manifest
) -> None:
    answer = saying(ONE_ROW)
    # Who was answered before, and now is not, takes the connection for lost.
    lost = [False, True, True, True, False]
    client = connected(lambda query: query.drop() if lost.pop(0) else answer(query))
    predictor = RemotePredictor(client, RemoteModel(manifest, "taxel"))
    for _ in range(2):
        assert np.all(predictor.predict(np.zeros((1, 6))) == 1)
    assert (lost, client.retries) == ([], 3)


def test_a_connection_that_stays_lost_is_told(
    connected: Callable[[Answer], RemoteSource], manifest: Manifest
) -> None:
    answer = saying(ONE_ROW)
    asked: list[float] = []

    def once(query: zenoh.Query) -> None:
        asked.append(time.monotonic())
        if len(asked) == 1:
            answer(query)
        else:
            query.drop()

    predictor = RemotePredictor(connected(once), RemoteModel(manifest, "taxel"))
    predictor.predict(np.zeros((1, 6)))
    with pytest.raises(ServerLost):
        predictor.predict(np.zeros((1, 6)), timeout=20)
    # It was sent again for 2 s, every 50 ms at most.
    assert 3 <= len(asked) <= 42
    assert asked[-1] - asked[1] < 10


def test_a_silent_server_exceeds_the_deadline(
    connected: Callable[[Answer], RemoteSource], manifest: Manifest
) -> None:
    held: list[zenoh.Query] = []
    client = connected(held.append)
    with pytest.raises(DeadlineExceeded, match=r"no answer to taxel/v2 within 0\.1 s"):
        client.get("taxel/v2", timeout=0.1)
    with pytest.raises(DeadlineExceeded):
        RemotePredictor(client, RemoteModel(manifest, "taxel")).predict(np.zeros((1, 6)), timeout=0.01)
    assert len(held) == 2


def test_a_typed_error_is_raised_as_itself(connected: Callable[[Answer], RemoteSource]) -> None:
    client = connected(refusing(pack_error(ResourceExhausted("the queue is full"))))
    with pytest.raises(ResourceExhausted, match=r"^the queue is full$"):
        client.models()


@pytest.mark.parametrize(
    "answer",
    [
        saying(b""),
        saying(b"\xc1"),
        saying(packb([])),
        saying(packb({})),
        saying(packb({"models": [{"name": "skin"}]})),
        saying(packb({"parameters": {"manifest": {"name": "skin"}}})),
        refusing(b""),
        refusing(b"no"),
        refusing(packb({"error": "out of ink", "code": "OUT_OF_INK"})),
    ],
)
def test_nonsense_is_the_servers_fault(connected: Callable[[Answer], RemoteSource], answer: Answer) -> None:
    client = connected(answer)
    with pytest.raises(Internal):
        client.models()
    with pytest.raises(Internal):
        client.predictor("skin")
    with pytest.raises(Internal):
        client.ready()


def test_predictions_for_other_windows_are_refused(
    connected: Callable[[Answer], RemoteSource], manifest: Manifest
) -> None:
    two = InferResponse(np.zeros((2, 21), np.float32), "skin", "1", None, 0, 0, 2)
    predictor = RemotePredictor(connected(saying(pack_infer_response(two))), RemoteModel(manifest, "taxel"))
    assert predictor.predict(np.zeros((2, 6))).shape == (2, 21)
    with pytest.raises(Internal, match="2 rows to 3 windows"):
        predictor.predict(np.zeros((3, 6)))


@pytest.mark.parametrize(
    ("name", "version"), [("", None), ("a b", None), ("*", None), ("skin?x=1", None), ("skin", "*")]
)
def test_a_name_that_no_model_can_have_is_not_found(
    connected: Callable[[Answer], RemoteSource], name: str, version: str | None
) -> None:
    asked: list[zenoh.Query] = []
    client = connected(asked.append)
    with pytest.raises(NotFound):
        client.predictor(name, version)
    assert asked == []


def test_a_version_that_is_no_text_is_told(connected: Callable[[Answer], RemoteSource]) -> None:
    asked: list[zenoh.Query] = []
    client = connected(asked.append)
    with pytest.raises(InvalidArgument, match="version is 1: expected a text such as '1', or None"):
        client.predictor("skin", 1)  # type: ignore[arg-type]
    assert asked == []


def test_a_closed_client_is_unavailable(connected: Callable[[Answer], RemoteSource]) -> None:
    client = connected(turning_away)
    client.close()
    with pytest.raises(Unavailable, match="closed"):
        client.models()


@pytest.fixture
def outcomes() -> "SimpleQueue[bytes | RequestError]":
    """What queries that nobody waited for came to."""
    return SimpleQueue()


def test_queries_that_nobody_waits_for_are_on_their_way_together(
    connected: Callable[[Answer], RemoteSource], outcomes: "SimpleQueue[bytes | RequestError]"
) -> None:
    held: SimpleQueue[zenoh.Query] = SimpleQueue()
    client = connected(held.put)
    for number in range(3):
        client.connection.send(f"taxel/{number}", b"", 10, outcomes.put)
    queries = [held.get(timeout=10) for _ in range(3)]
    assert outcomes.empty()
    for query in reversed(queries):
        saying(str(query.key_expr).encode())(query)
    found = [outcomes.get(timeout=10) for _ in range(3)]
    assert found == [b"taxel/2", b"taxel/1", b"taxel/0"]
    client.close()
    assert outcomes.empty()


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (refusing(pack_error(ResourceExhausted("full"))), ResourceExhausted, "full"),
        (turning_away, PermissionDenied, "taxel/v2 gets no answer"),
    ],
)
def test_a_query_that_nobody_waits_for_has_the_same_errors(
    connected: Callable[[Answer], RemoteSource],
    outcomes: "SimpleQueue[bytes | RequestError]",
    answer: Answer,
    error: type[RequestError],
    message: str,
) -> None:
    client = connected(answer)
    client.connection.send("taxel/v2", b"", 10, outcomes.put)
    found = outcomes.get(timeout=10)
    with pytest.raises(error) as caught:
        client.get("taxel/v2")
    assert type(found) is error
    assert message in str(found) == str(caught.value)


def test_a_query_that_nobody_waits_for_ends_in_time(
    connected: Callable[[Answer], RemoteSource], outcomes: "SimpleQueue[bytes | RequestError]"
) -> None:
    held: list[zenoh.Query] = []
    client = connected(held.append)
    client.connection.send("taxel/v2", b"", 0.1, outcomes.put)
    found = outcomes.get(timeout=10)
    assert isinstance(found, DeadlineExceeded)
    assert "no answer to taxel/v2 within 0.1 s" in str(found)
    client.close()
    client.connection.send("taxel/v2", b"", 10, outcomes.put)
    assert isinstance(outcomes.get(timeout=10), Unavailable)


def test_answers_may_be_fetched_after_later_queries_were_sent(
    connected: Callable[[Answer], RemoteSource],
) -> None:
    def repeating(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, query.payload)

    connection = connected(repeating).connection
    connection.prepare("taxel/v2", 10)
    answers = [connection.start("taxel/v2", bytes([number]), 10) for number in range(5)]
    assert [answer() for answer in answers] == [bytes([number]) for number in range(5)]


def test_new_fields_of_a_newer_servers_index_are_ignored(
    connected: Callable[[Answer], RemoteSource],
) -> None:
    model = {
        "name": "skin",
        "version": "1",
        "state": "READY",
        "reason": "",
        "platform": "xgboost_json",
        "combination": 1,
        "colour": "blue",
    }
    client = connected(lambda query: query.reply(query.key_expr, packb({"models": [model]})))
    assert [(found.name, found.state) for found in client.models()] == [("skin", "READY")]
