"""The client on a lane: which transport it takes, and what it does when the lane is lost."""

import signal
import socket
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from numpy.typing import NDArray

import taxel
from taxel.errors import DeadlineExceeded, InvalidArgument, SettingsError, Unavailable
from taxel.lane.client import Lane
from taxel.lane.connection import ConnectionLost
from taxel.lane.offer import LaneOffer, machine_identity
from taxel.protocol import unpackb
from taxel.remote import core
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.processor import keep_cores_awake
from taxel_server.service import Service
from taxel_server.transports import lane_transport

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]


@pytest.fixture
def service(engine: Engine, endpoint: str) -> Iterator[Service]:
    started = Service(engine, ServerOptions(listen=(endpoint,))).start()
    yield started
    started.close()


def test_metadata_tell_where_the_lane_is(service: Service, endpoint: str) -> None:
    with taxel.connect(endpoint) as source:
        told = unpackb(source.get("taxel/v2"))
    assert LaneOffer.read(told) == service.lane
    assert service.lane is not None
    assert service.lane.machine == machine_identity()


@pytest.mark.parametrize(
    "told",
    [
        None,
        [],
        {},
        {"lane": None},
        {"lane": {"address": "unix:/x"}},
        {"lane": {"address": 1, "machine": 2}},
    ],
)
def test_an_offer_that_cannot_be_understood_is_none(told: object) -> None:
    assert LaneOffer.read(told) is None


def test_another_machines_lane_is_left_alone(
    service: Service, endpoint: str, monkeypatch: pytest.MonkeyPatch, make_windows: WindowMaker
) -> None:
    monkeypatch.setattr(core, "machine_identity", lambda: "another")
    with taxel.connect(endpoint) as source:
        predictor = source.predictor("skin")
        assert (predictor.transport, predictor.predict(make_windows(1)).shape) == ("zenoh", (1, 21))
    with pytest.raises(Unavailable, match="no lane"):
        taxel.connect(endpoint, transport="lane")


def test_a_transport_that_there_is_none_of_is_told(endpoint: str) -> None:
    with pytest.raises(InvalidArgument, match="expected 'lane', 'zenoh' or None"):
        taxel.connect(endpoint, transport="carrier pigeon")  # type: ignore[arg-type]


def test_a_restarted_server_is_found_again_and_the_retry_is_counted(
    engine: Engine, endpoint: str, make_windows: WindowMaker
) -> None:
    windows = make_windows(3)
    service = Service(engine, ServerOptions(listen=(endpoint,))).start()
    with taxel.connect(endpoint, transport="lane") as source:
        predictor = source.predictor("skin")
        before = predictor.predict(windows)
        service.close()
        with pytest.raises(Unavailable, match=r"lane was lost|no lane"):
            predictor.predict(windows)
        again = Service(engine, ServerOptions(listen=(endpoint,))).start()
        retries = source.retries
        try:
            while source.transport != "lane":
                pass
            np.testing.assert_array_equal(predictor.predict(windows), before)
            assert source.retries == retries
            again.close()
            again = Service(engine, ServerOptions(listen=(endpoint,))).start()
            np.testing.assert_array_equal(predictor.predict(windows), before)
            assert source.retries == retries + 1
        finally:
            again.close()


def test_over_zenoh_a_restarted_server_is_asked_again_within_the_time(
    engine: Engine, endpoint: str, make_windows: WindowMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    # On a busy machine, a server may take longer to start than calls wait for it.
    monkeypatch.setattr(core, "_RECONNECT_S", 20.0)
    windows = make_windows(3)
    service = Service(engine, ServerOptions(listen=(endpoint,))).start()
    with taxel.connect(endpoint, transport="zenoh", timeout=20) as source, ThreadPoolExecutor(1) as pool:
        predictor = source.predictor("skin")
        before = predictor.predict(windows)
        service.close()
        # For a moment the client knows that the key is gone, and not yet that the connection is.
        while source.connection.connected:
            pass
        with pytest.raises(Unavailable, match="the connection to the server was lost"):
            predictor.predict(windows, timeout=0.05)
        waiting = pool.submit(predictor.predict, windows)
        service = Service(engine, ServerOptions(listen=(endpoint,))).start()
        np.testing.assert_array_equal(waiting.result(), before)
        assert source.retries == 1
    service.close()


def test_where_the_lane_is_lost_zenoh_is_asked(
    service: Service, endpoint: str, make_windows: WindowMaker
) -> None:
    windows = make_windows(3)
    with taxel.connect(endpoint) as source:
        predictor = source.predictor("skin")
        before = predictor.predict(windows)
        assert predictor.transport == "lane"
        service._lane.close()
        np.testing.assert_array_equal(predictor.predict(windows), before)
        assert (predictor.transport, source.retries) == ("zenoh", 1)
        np.testing.assert_array_equal(predictor.predict(windows), before)
        assert source.retries == 1


def test_a_repeated_request_is_checked_and_sent_again_as_any_other(
    engine: Engine, endpoint: str, make_windows: WindowMaker
) -> None:
    good, wrong = make_windows(2), make_windows(2)
    wrong[1, 3] = np.nan
    expected = engine.model("skin").evaluate(good)
    service = Service(engine, ServerOptions(listen=(endpoint,))).start()
    with taxel.connect(endpoint, transport="lane") as source:
        predictor = source.predictor("skin")

        def repeat(windows: NDArray[np.float32]) -> None:
            for _ in range(3):
                np.testing.assert_array_equal(predictor.predict(windows), expected)

        repeat(good)
        with pytest.raises(InvalidArgument, match=r"window\[1, .*is nan"):
            predictor.predict(wrong)
        repeat(good.astype(np.float64))
        repeat(np.asfortranarray(good))
        assert unpackb(source.get("taxel/v2/models/skin/stats"))["requests"] == 10
        service.close()
        service = Service(engine, ServerOptions(listen=(endpoint,))).start()
        repeat(good)
        assert source.retries == 1
        service.close()
        with pytest.raises(Unavailable, match="lane was lost"):
            predictor.predict(good)


def test_clients_beyond_the_most_take_zenoh(
    engine: Engine, start: ServerStarter, make_windows: WindowMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lane_transport, "_MOST_CLIENTS", 1)
    place = start(engine)
    with taxel.connect(place) as first, taxel.connect(place) as second:
        assert first.predictor("skin").predict(make_windows(1)).shape == (1, 21)
        predictor = second.predictor("skin")
        assert predictor.predict(make_windows(1)).shape == (1, 21)
        assert (predictor.transport, second.retries) == ("zenoh", 1)


def test_a_lane_that_is_lost_late_leaves_zenoh_the_rest_of_the_time(
    service: Service, endpoint: str, make_windows: WindowMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []

    def lose(*_: object, **__: object) -> None:
        time.sleep(0.4)
        # Nobody listens any more, so the lane is not tried a second time.
        raise OSError

    with taxel.connect(endpoint, timeout=20) as source:
        predictor = source.predictor("skin")
        assert source.transport == "lane"
        start = source.connection.start
        monkeypatch.setattr(Lane, "infer", lose)
        monkeypatch.setattr(
            source.connection, "start", lambda *given: waits.append(given[2]) or start(*given)
        )
        assert predictor.predict(make_windows(1)).shape == (1, 21)
    (wait,) = waits
    assert 0 < wait <= 20.25 - 0.4


def test_spinning_ends_give_the_same_answers(
    engine: Engine, endpoint: str, make_windows: WindowMaker
) -> None:
    service = Service(engine, ServerOptions(listen=(endpoint,), spin_us=200)).start()
    with taxel.connect(endpoint, transport="lane", spin_us=200) as source:
        predictor = source.predictor("skin")
        for rows in (1, 1, 300):
            windows = make_windows(rows)
            np.testing.assert_array_equal(
                predictor.predict(windows), engine.model("skin").evaluate(windows)
            )
    service.close()


def test_cores_are_kept_awake_while_the_device_is_open(tmp_path: Path) -> None:
    device = tmp_path / "cpu_dma_latency"
    with pytest.raises(SettingsError, match=r"--no-halt: .*No such file"):
        keep_cores_awake(device)
    assert not device.exists()
    device.touch()
    with keep_cores_awake(device):
        assert device.read_bytes() == bytes(4)


def test_a_closed_source_is_unavailable(service: Service, endpoint: str, make_windows: WindowMaker) -> None:
    source = taxel.connect(endpoint)
    predictor = source.predictor("skin")
    predictor.predict(make_windows(1))
    source.close()
    with pytest.raises(Unavailable):
        predictor.predict(make_windows(1))


def test_threads_share_a_predictor(
    service: Service, engine: Engine, endpoint: str, make_windows: WindowMaker
) -> None:
    evaluate = engine.model("skin").evaluate
    with taxel.connect(endpoint, transport="lane") as source, ThreadPoolExecutor(8) as pool:
        predictor = source.predictor("skin")

        def ask(seed: int) -> None:
            windows = make_windows(1 + seed % 40, seed=seed)
            np.testing.assert_array_equal(predictor.predict(windows), evaluate(windows))

        assert len(list(pool.map(ask, range(400)))) == 400


@pytest.fixture
def imposter(tmp_path: Path) -> Iterator[Callable[[bytes], Lane]]:
    """A lane to a server that sends some bytes after each request, and then nothing more."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "lane"))
    listener.listen()
    opened: list[socket.socket | Lane] = []

    def make(reply: bytes) -> Lane:
        def serve() -> None:
            client, _ = listener.accept()
            opened.append(client)
            client.recv(10_000)
            client.sendall(reply)

        thread = Thread(target=serve)
        thread.start()
        lane = Lane(f"unix:{tmp_path / 'lane'}")
        opened.append(lane)
        return lane

    yield make
    for each in (*opened, listener):
        each.close()


@pytest.mark.parametrize("reply", [b"", b"TXL1", b"TXL1\x20\0\0\0"])
def test_a_silent_lane_exceeds_the_deadline(imposter: Callable[[bytes], Lane], reply: bytes) -> None:
    with pytest.raises(DeadlineExceeded, match=r"no answer within 0\.1 s"):
        imposter(reply).infer("v2/models/skin/infer", np.zeros((1, 6), np.float32), 0.1, 0.1, spread=False)


@pytest.mark.parametrize("reply", [b"", b"TXL1\x20\0\0\0"])
def test_signals_put_no_deadline_off(imposter: Callable[[bytes], Lane], reply: bytes) -> None:
    """Each interrupts the wait, which must not begin anew."""
    lane, seen = imposter(reply), []

    def tick(*_: object) -> None:
        seen.append(None)
        if len(seen) > 100:
            raise RuntimeError("the deadline did not come in 50 times its time")

    before = signal.signal(signal.SIGALRM, tick)
    signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
    try:
        with pytest.raises(DeadlineExceeded, match=r"no answer within 0\.2 s"):
            lane.infer("v2/models/skin/infer", np.zeros((1, 6), np.float32), 0.2, 0.2, spread=False)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("transport", ["lane", "zenoh"])
@pytest.mark.parametrize("rows", [1, 3, 3000])
def test_counts_are_the_callers_to_change(
    service: Service, endpoint: str, make_windows: WindowMaker, transport: str, rows: int
) -> None:
    with taxel.connect(endpoint, transport=transport) as source:
        predictor = source.predictor("skin")
        for _ in range(3):
            counts = predictor.predict(make_windows(rows))
            counts -= counts.mean(axis=0)
        again = predictor.predict(make_windows(rows))
    assert np.abs(again).mean() > np.abs(counts).mean()


def test_nonsense_on_a_lane_counts_as_lost(imposter: Callable[[bytes], Lane]) -> None:
    with pytest.raises(ConnectionLost, match="expected the lane's") as lost:
        imposter(b"HTTP/1.1 400 Bad Request\r\n\r\n" * 2).infer(
            "v2/models/skin/infer", np.zeros((1, 6), np.float32), 1, 1, spread=False
        )
    assert lost.value.new
