"""Where the lane listens, and with whom it talks."""

import os
import socket
import stat
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import taxel
from taxel.errors import SettingsError, TaxelError, Unavailable
from taxel.lane import offer
from taxel.lane.client import Lane
from taxel.lane.offer import connect_to, of_this_user
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.service import Service
from taxel_server.settings import read_settings
from taxel_server.transports import lane_transport
from taxel_server.transports.lane_socket import LaneSocket, automatic_address

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]


def test_where_it_listens(engine: Engine, tmp_path: Path, endpoint: str, make_windows: WindowMaker) -> None:
    path = tmp_path / "lane.sock"
    other = endpoint.replace("127.0.0.1", "127.0.0.2")
    for lane, address in (
        (f"unix:{path}", f"unix:{path}"),
        ("tcp:127.0.0.1:0", "tcp:127.0.0.1:"),
        ("off", ""),
    ):
        service = Service(engine, ServerOptions(listen=(endpoint,), lane=lane))
        assert not path.exists()
        service.start()
        with taxel.connect(endpoint) as source:
            predictor = source.predictor("skin")
            assert predictor.transport == ("lane" if address else "zenoh")
            assert predictor.predict(make_windows(3)).shape == (3, 21)
        assert (service.lane.address if service.lane else "").startswith(address)
        if lane.startswith("unix"):
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
            with pytest.raises(TaxelError, match="another server listens there"):
                Service(engine, ServerOptions(listen=(other,), lane=lane)).start()
        service.close()
        assert not path.exists()


def test_the_file_of_a_killed_server_is_replaced_and_no_other(
    engine: Engine, tmp_path: Path, endpoint: str
) -> None:
    path = tmp_path / "lane.sock"
    options = ServerOptions(listen=(endpoint,), lane=f"unix:{path}")
    path.write_text("mine")
    with pytest.raises(TaxelError, match="no socket"):
        Service(engine, options).start()
    assert path.read_text() == "mine"
    path.rename(tmp_path / "linked")
    path.symlink_to(tmp_path / "linked")
    with pytest.raises(TaxelError, match="no socket"):
        Service(engine, options).start()
    assert path.is_symlink()
    path.unlink()
    with socket.socket(socket.AF_UNIX) as left_behind:
        left_behind.bind(str(path))
    service = Service(engine, options).start()
    connect_to(f"unix:{path}").close()
    service.close()


@pytest.mark.parametrize("lane", ["on", "unix:", "tcp:10.0.0.1:80", "tcp:127.0.0.1:", "tcp:localhost:x"])
def test_an_address_that_is_none_or_not_local_is_told(lane: str) -> None:
    with pytest.raises(SettingsError, match="expected unix:PATH, or tcp:127"):
        read_settings({"lane": lane})


def open_to_all(folder: Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)


def a_link(folder: Path) -> None:
    (folder.parent / "elsewhere").mkdir(mode=0o700)
    folder.symlink_to(folder.parent / "elsewhere")


@pytest.mark.parametrize("make", [open_to_all, a_link, Path.touch])
def test_without_a_folder_of_its_own_there_is_no_automatic_lane(
    engine: Engine,
    start: ServerStarter,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    make: Callable[[Path], None],
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    make(tmp_path / "taxel")
    place = start(engine)
    with pytest.raises(Unavailable, match="no lane"):
        taxel.connect(place, transport="lane")
    with taxel.connect(place) as source:
        assert source.predictor("skin").transport == "zenoh"


def test_a_runtime_folder_that_is_relative_or_another_users_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert automatic_address(["tcp/a:1"]).startswith(f"unix:{tmp_path}/taxel/")
    assert automatic_address(["tcp/a:1"]) != automatic_address(["tcp/a:2"])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", ".")
    assert not automatic_address(["tcp/a:1"]).startswith(("unix:taxel", f"unix:{tmp_path}"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    # Not even the folder that it makes there has the owner that it should have.
    with pytest.raises(TaxelError, match=f"temporary/taxel-{user + 1}: expected a folder of this user"):
        automatic_address(["tcp/a:1"])


def test_clients_are_told_the_whole_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    listening = LaneSocket("unix:lane.sock")
    assert listening.address == f"unix:{tmp_path / 'lane.sock'}"
    monkeypatch.chdir("/")
    connect_to(listening.address).close()
    listening.close()
    assert not (tmp_path / "lane.sock").exists()


class Peer:
    """A connection whose other end belongs to a user."""

    def __init__(self, user: int) -> None:
        self.user = user

    def getsockopt(self, *_: Any) -> bytes:
        return struct.pack("3i", 4711, self.user, 0)


@pytest.mark.skipif(not hasattr(socket, "SO_PEERCRED"), reason="this system does not tell the user")
def test_only_this_user_and_root_are_talked_with(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    taken = [user for user in (0, 1, 999, 1000, 1001) if of_this_user(Peer(user))]  # type: ignore[arg-type]
    assert taken == [0, 1000]


def test_another_users_client_is_closed_and_another_users_server_is_left(
    engine: Engine, endpoint: str, make_windows: WindowMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = Service(engine, ServerOptions(listen=(endpoint,))).start()
    assert service.lane is not None
    with monkeypatch.context() as patched:
        patched.setattr(lane_transport, "of_this_user", lambda _: False)
        with taxel.connect(endpoint) as source:
            predictor = source.predictor("skin")
            assert predictor.predict(make_windows(1)).shape == (1, 21)
            assert predictor.transport == "zenoh"
    with monkeypatch.context() as patched:
        patched.setattr(offer, "of_this_user", lambda _: False)
        with pytest.raises(PermissionError, match="another user listens there"):
            Lane(service.lane.address)
        with taxel.connect(endpoint) as source:
            assert source.transport == "zenoh"
    service.close()
