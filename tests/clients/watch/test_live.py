"""A server's traffic as a source: who is shown, what, and that nothing is followed while nobody looks."""

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taxel
from taxel.errors import PermissionDenied
from taxel.local import shipped_repository
from taxel.protocol import unpackb
from taxel.remote import RemoteSource
from taxel.skin import PAD
from taxel_server.core.traffic import Traffic
from taxel_server.options import ServerOptions
from taxel_server.transports.memory import MemoryServer
from taxel_watch.live import Live
from taxel_watch.scene import PREDICTED, Player, Update

MODEL = "network-b"


@pytest.fixture(scope="module")
def repository(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One shipped model."""
    folder = tmp_path_factory.mktemp("repository")
    shutil.copytree(shipped_repository() / MODEL, folder / MODEL)
    return folder


@pytest.fixture(scope="module")
def server(repository: Path) -> Iterator[MemoryServer]:
    with MemoryServer(repository, ServerOptions(watchable=True)) as server:
        yield server


@pytest.fixture
def source(server: MemoryServer) -> Iterator[RemoteSource]:
    with taxel.connect(transport=server) as source:
        yield source


def look(source: RemoteSource) -> list[dict[str, Any]]:
    clients: list[dict[str, Any]] = unpackb(source.get(f"{source.prefix}/v2/watch"))["clients"]
    return clients


def until(found: Callable[[], Any]) -> Any:
    """What is found, in the end."""
    ends = time.monotonic() + 30
    while not (value := found()):
        assert time.monotonic() < ends
        time.sleep(0.005)
    return value


def windows(source: RemoteSource, press: float, fingers: int = 3) -> Any:
    """One window for each fingertip: the n-th is pressed n times as hard."""
    features = source.predictor(MODEL).manifest.window.features
    values = dict(zip("xyz", PAD, strict=True)) | {"fz": press}
    rows = np.array([[values.get(name, 0.0) for name in features]] * fingers, np.float32)
    rows[:, features.index("fz")] *= np.arange(1, fingers + 1)
    return rows


def test_a_look_tells_the_newest_request_of_a_client(source: RemoteSource) -> None:
    predictor = source.predictor(MODEL)
    look(source)

    def asked() -> Any:
        counts = predictor.predict(windows(source, 0.5))
        told = [client for client in look(source) if client.get("fingers") == 3]
        return (told[0], counts) if told else None

    client, counts = until(asked)
    assert (client["model"], client["version"], client["fingers"]) == (MODEL, "1", 3)
    contacts = np.frombuffer(client["contacts"], "<f4").reshape(3, 6)
    np.testing.assert_allclose(contacts[:, :3], [PAD] * 3, rtol=1e-6)
    np.testing.assert_allclose(contacts[:, 5], [0.5, 1.0, 1.5])
    np.testing.assert_array_equal(np.frombuffer(client["counts"], "<f4").reshape(3, 21), counts)
    untouched = predictor.predict(windows(source, 0.0, 1))
    np.testing.assert_allclose(client["rest"], untouched[0], rtol=1e-5)


def test_requests_are_counted(source: RemoteSource) -> None:
    predictor = source.predictor(MODEL)
    look(source)
    before = sum(client["requests"] for client in look(source))
    for press in range(20):
        predictor.predict(windows(source, 0.1 * press, 2))
    # An answer is noted after it is given.
    until(lambda: look(source)[0]["requests"] >= before + 20)
    assert look(source)[0]["requests"] == before + 20


def test_large_requests_show_their_first_fingertips(source: RemoteSource) -> None:
    def asked() -> Any:
        source.predictor(MODEL).predict(windows(source, 0.01, 500))
        return next((client for client in look(source) if client.get("fingers") == 32), None)

    assert len(until(asked)["counts"]) == 32 * 21 * 4


def test_nothing_is_followed_while_nobody_looks(server: MemoryServer, source: RemoteSource) -> None:
    core = server._core
    look(source)
    assert core.traffic is not None
    core.traffic._until = 0.0
    source.predictor(MODEL).predict(windows(source, 0.5))
    until(lambda: core.traffic is None)
    assert core.submit == core._batcher.submit
    assert core.run == core._batcher.run


def test_a_server_may_be_watched_only_if_its_options_say_so(repository: Path) -> None:
    with MemoryServer(repository) as closed, taxel.connect(transport=closed) as source:
        with pytest.raises(PermissionDenied, match="expected one with --watchable"):
            look(source)
        with pytest.raises(PermissionDenied, match="--watchable"):
            Live(source)


def test_too_many_clients_are_left_out() -> None:
    follows: list[bool] = []
    traffic = Traffic(follows.append)
    traffic.look()
    model: Any = object()
    for number in range(80):
        traffic.note(
            f"pid {number}", model, np.zeros((1, 12), np.float32), np.zeros((1, 21), np.float32), 1
        )
    assert len(traffic._clients) == 64
    assert follows == [True]


def shown(player: Player, finger: int) -> Update | None:
    """An update with a new moment of a fingertip, if there is one."""
    update = player.update()
    return update if update and any(key.endswith(f" {finger}") for key in update.fingers) else None


def test_a_player_shows_each_window_as_a_fingertip(source: RemoteSource) -> None:
    predictor = source.predictor(MODEL)
    with closing(Live(source)) as live:
        player = live.player()
        first = player.scene()
        assert first is not None
        assert first.duration_s is None

        def asked() -> Any:
            predictor.predict(windows(source, 0.7))
            scene = player.scene()
            return scene if scene and len(scene.fingers) == 3 else None

        scene = until(asked)
        assert [finger.label for finger in scene.fingers] == ["finger 1", "finger 2", "finger 3"]
        assert len({finger.hand for finger in scene.fingers}) == 1
        assert dict(scene.traces) == {PREDICTED: f"{MODEL}/1"}

        def moved() -> Any:
            counts = predictor.predict(windows(source, 1.1))
            update = shown(player, 2)
            block = update.fingers[scene.fingers[2].key] if update else None
            same = block is not None and np.array_equal(block.counts[PREDICTED][0], counts[2])
            return block if same else None

        block = until(moved)
        np.testing.assert_allclose(block.force[0], [0.0, 0.0, 3.3], rtol=1e-6)
        status = until(lambda: player.status() if player.status()["server"] else None)
        assert status["state"] == "live"
        assert status["rate_hz"] > 0
        assert status["latency_us"]["p99"] >= status["latency_us"]["p50"] > 0
        assert {"up", "clients", "queue", "memory"} == set(status["server"])


def test_a_server_that_stops_is_told(repository: Path) -> None:
    with (
        MemoryServer(repository, ServerOptions(watchable=True)) as server,
        taxel.connect(transport=server) as source,
        closing(Live(source)) as live,
    ):
        player = live.player()
        assert player.status()["state"] == "waiting"
        server.close()
        status = until(lambda: player.status() if player.status()["state"] == "no answer" else None)
        assert "trying again" in status["note"]
