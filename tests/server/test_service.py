"""The service over real zenoh sessions: what it answers to good requests."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray

import taxel
from taxel.envelopes import RequestReader
from taxel.errors import Internal, NotFound, PermissionDenied, TaxelError, Unavailable
from taxel.predictor import ModelInfo
from taxel.protocol import pack_infer_request, unpack_infer_response, unpackb
from taxel.remote import RemoteSource, Transport
from taxel_bench.plain_client import client_config
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.service import Service

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]


@pytest.fixture
def client(engine: Engine, start: ServerStarter) -> Iterator[RemoteSource]:
    with taxel.connect(start(engine)) as source:
        yield source


def unmeasured(models: list[ModelInfo]) -> list[ModelInfo]:
    """Without the evaluators, which each process chooses by its own measurement."""
    return [replace(model, one_row="", many_rows="") for model in models]


@pytest.mark.parametrize("transport", ["zenoh", "lane"])
def test_remote_and_local_agree(
    engine: Engine, start: ServerStarter, repository: Path, make_windows: WindowMaker, transport: Transport
) -> None:
    with taxel.load(repository) as local, taxel.connect(start(engine), transport=transport) as client:
        for name, version, features in (("skin", None, 6), ("skin", "2", 6), ("wide", None, 12)):
            remote, near = client.predictor(name, version), local.predictor(name, version)
            assert remote.manifest == near.manifest
            assert remote.transport == transport
            for rows in (1, 7, 3000):
                windows = make_windows(rows, features, seed=rows)
                np.testing.assert_array_equal(remote.predict(windows), near.predict(windows))
        assert unmeasured(client.models()) == unmeasured(local.models())


def test_the_server_describes_itself(client: RemoteSource) -> None:
    assert unpackb(client.get("taxel/v2"))["name"] == "taxel"
    assert unpackb(client.get("taxel/v2/health/live")) == {"live": True}
    assert unpackb(client.get("taxel/v2/health/ready")) == {"ready": True}
    assert client.ready()


def test_a_model_is_described_in_the_protocols_words(client: RemoteSource) -> None:
    described = unpackb(client.get("taxel/v2/models/skin"))
    assert (described["name"], described["versions"]) == ("skin", ["2", "10"])
    assert described["platform"] == "xgboost_json"
    assert described["inputs"] == [{"name": "window", "datatype": "FP32", "shape": [-1, 6]}]
    assert described["outputs"] == [{"name": "channels", "datatype": "FP32", "shape": [-1, 21]}]
    assert described["parameters"]["manifest"]["version"] == "10"
    assert unpackb(client.get("taxel/v2/models/skin/versions/2/ready")) == {"ready": True}


def test_id_and_times_come_back(client: RemoteSource, make_windows: WindowMaker) -> None:
    request = pack_infer_request(make_windows(5), request_id="touch 1")
    response = unpack_infer_response(client.get("taxel/v2/models/skin/infer", request))
    assert (response.id, response.model_name, response.model_version) == ("touch 1", "skin", "10")
    assert response.batch_rows == 5
    assert response.queue_us >= 0
    assert response.compute_us > 0


def test_a_reply_tells_how_long_the_server_took(client: RemoteSource, make_windows: WindowMaker) -> None:
    predictor = client.predictor("skin")
    windows = make_windows(5)
    reply = predictor.infer(windows)
    np.testing.assert_array_equal(reply.outputs, predictor.predict(windows))
    assert (reply.batch_rows, reply.compute_us > 0, reply.queue_us >= 0) == (5, True, True)
    assert reply.spread is None
    with pytest.raises(taxel.InvalidArgument, match="gives no spread"):
        predictor.infer(windows, spread=True)


def test_statistics_count_requests_rows_and_errors(
    engine: Engine, start: ServerStarter, make_windows: WindowMaker
) -> None:
    with taxel.connect(start(engine, max_batch_rows=16)) as client:
        predictor = client.predictor("wide")
        predictor.predict(make_windows(3, 12))
        predictor.predict(make_windows(40, 12))
        with pytest.raises(taxel.InvalidArgument):
            client.get("taxel/v2/models/wide/infer", b"nonsense")
        counted = unpackb(client.get("taxel/v2/models/wide/stats"))
    assert (counted["requests"], counted["rows"], counted["errors"]) == (3, 43, {"INVALID_ARGUMENT": 1})
    assert counted["batch_rows"]["buckets"] == {"4": 1, "8": 1, "16": 2}


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("taxel", "no key"),
        ("taxel/v1", "no key 'v1'"),
        ("taxel/v2/models", "no key"),
        ("taxel/v2/models/skin/weights", "no key"),
        ("taxel/v2/models/skin/versions/2/infer/more", "no key"),
        ("taxel/v2/models/*/infer", r"no model '\*'"),
        ("taxel/v2/models/skn", "no model 'skn'; there is: skin, wide"),
        ("taxel/v2/models/skn/infer", "no model 'skn'; there is: skin, wide"),
        ("taxel/v2/models/skn/ready", "no model 'skn'; there is: skin, wide"),
        ("taxel/v2/models/skin/versions/3/infer", "no version '3'; it has: 2, 10"),
    ],
)
def test_unknown_keys_are_not_found(client: RemoteSource, key: str, text: str) -> None:
    with pytest.raises(NotFound, match=text):
        client.get(key)


def test_a_question_to_all_keys_gets_no_answer(client: RemoteSource) -> None:
    with pytest.raises(PermissionDenied):
        client.get("taxel/**")


def test_another_prefix_is_another_server(
    engine: Engine, start: ServerStarter, make_windows: WindowMaker
) -> None:
    place = start(engine, prefix="left/hand")
    with taxel.connect(place, prefix="left/hand") as client:
        assert client.predictor("skin").predict(make_windows(2)).shape == (2, 21)
        with pytest.raises(NotFound, match="no key 'v3'"):
            client.get("left/hand/v3")
    with taxel.connect(place) as stranger, pytest.raises(Unavailable, match="nobody answers"):
        stranger.models()


def test_a_damaged_artifact_is_listed_and_refused(
    tmp_path: Path, make_artifact: Callable[..., Path], start: ServerStarter, make_windows: WindowMaker
) -> None:
    make_artifact(tmp_path, "skin", "1")
    (make_artifact(tmp_path, "torn", "1") / "model.json").write_text("{")
    with taxel.connect(start(Engine(tmp_path))) as client:
        assert [(model.name, model.state) for model in client.models()] == [
            ("skin", "READY"),
            ("torn", "UNAVAILABLE"),
        ]
        assert "its manifest says" in client.models()[1].reason
        assert unpackb(client.get("taxel/v2/models/torn/ready")) == {"ready": False}
        for action in ("", "/infer", "/stats"):
            with pytest.raises(Unavailable, match="its manifest says"):
                client.get(f"taxel/v2/models/torn{action}")
        assert client.predictor("skin").predict(make_windows(1)).shape == (1, 21)


def test_an_occupied_port_is_told(engine: Engine, start: ServerStarter) -> None:
    place = start(engine)
    with pytest.raises(TaxelError, match=f"cannot listen on {place}.*in use"):
        Service(engine, ServerOptions(repository=Path("unused"), listen=(place,))).start()


def test_concurrent_clients_get_their_own_rows(
    engine: Engine, start: ServerStarter, make_windows: WindowMaker
) -> None:
    place = start(engine, max_batch_rows=32)
    evaluate = {name: engine.model(name).evaluate for name in ("skin", "wide")}

    def ask(number: int) -> int:
        name, features = (("skin", 6), ("wide", 12))[number % 2]
        with taxel.connect(place) as client:
            predictor = client.predictor(name)
            for turn in range(30):
                windows = make_windows(
                    1 + (number * 7 + turn * 13) % 50, features, seed=100 * number + turn
                )
                np.testing.assert_array_equal(predictor.predict(windows), evaluate[name](windows))
        return number

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(ask, range(8))) == list(range(8))


def test_every_query_gets_exactly_one_reply(
    engine: Engine, start: ServerStarter, make_windows: WindowMaker
) -> None:
    payloads = [pack_infer_request(make_windows(rows)) for rows in (1, 2, 70)] + [
        b"",
        b"\xc1",
        b"\x80" * 50,
    ]
    with zenoh.open(client_config(start(engine))) as session:
        asked = [
            session.get("taxel/v2/models/skin/infer", payload=payload, timeout=10)
            for _ in range(20)
            for payload in payloads
        ]
        answers = [[reply.ok is not None for reply in replies] for replies in asked]
    assert answers == [[True], [True], [True], [False], [False], [False]] * 20


def test_a_query_that_cannot_be_handed_on_is_answered_and_harms_no_other(
    engine: Engine,
    start: ServerStarter,
    make_windows: WindowMaker,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    rows_in = RequestReader.rows_in
    sizes = []

    def fail_once(self: RequestReader, size: int, features: int) -> int:
        sizes.append(size)
        if len(sizes) == 1:
            raise ArithmeticError("odd")
        return rows_in(self, size, features)

    monkeypatch.setattr(RequestReader, "rows_in", fail_once)
    with taxel.connect(start(engine), transport="zenoh") as client:
        predictor = client.predictor("skin")
        with pytest.raises(Internal, match="the server's log says more"):
            predictor.predict(make_windows(1))
        assert predictor.predict(make_windows(1)).shape == (1, 21)
    assert "ArithmeticError: odd" in caplog.text
