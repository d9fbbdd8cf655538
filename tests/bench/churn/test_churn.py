"""What clients leave in a server that come, send large requests, and go or are killed."""

import shutil
from collections.abc import Iterator

import pytest

from taxel.remote.options import Transport
from taxel_bench.churn import measurement
from taxel_bench.churn.measurement import Held, let_them_come, reasons_against
from taxel_bench.server_process import ROOM, RunningServer, running_server_process
from taxel_models.shipped import shipped_repository


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    repository = tmp_path_factory.mktemp("repository")
    shutil.copytree(shipped_repository() / "xgb", repository / "xgb")
    with running_server_process(repository, *ROOM) as running:
        yield running


@pytest.mark.parametrize(
    ("transport", "clients"), [("lane", 30), pytest.param("zenoh", 30, marks=pytest.mark.long)]
)
def test_clients_that_come_and_go_or_are_killed_leave_nothing(
    server: RunningServer, transport: Transport, clients: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measurement, "IN_ONE_PROCESS", 10)
    told: list[int] = []
    held = let_them_come(server, "xgb", transport, clients, 4096, told.append)
    assert told == list(range(10, clients + 1, 10))
    assert [each.clients for each in held] == [0, *told]
    assert not reasons_against(held)


def test_what_grows_is_named() -> None:
    flat = [Held(clients, 300.0, 20, 18, 0) for clients in (0, 20, 40, 60)]
    assert not reasons_against(flat)
    grown = Held(80, 400.0, 21, 19, 1)
    assert reasons_against([*flat, grown]) == [
        "memory grew from 300 to 400 MiB",
        "files grew from 20 to 21",
        "threads grew from 18 to 19",
        "shared files grew from 0 to 1",
    ]
