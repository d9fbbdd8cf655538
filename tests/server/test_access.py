"""Who gets in over zenoh, what they may do there, and that nobody else can answer for a server."""

import asyncio
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import trustme
import zenoh
from numpy.typing import NDArray
from zenoh.handlers import Callback

import taxel
from taxel import Credentials
from taxel.errors import NotFound, PermissionDenied, SettingsError, Unavailable
from taxel.protocol import packb
from taxel_bench.plain_client import client_config
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.service import Service
from taxel_server.transports.access import read_users
from taxel_server.transports.zenoh_session import open_session

ServerStarter = Callable[..., str]
WindowMaker = Callable[..., NDArray[np.float32]]

PATIENT = 60.0
"""A timeout that no test waits for: an answer that took as long as this would be a failure."""

INFER = "taxel/v2/models/skin/infer"
LOAD = "taxel/v2/repository/models/skin/load"


@pytest.fixture
def users(tmp_path: Path) -> Path:
    file = tmp_path / "users"
    file.write_text("robot:walks\nvisitor:looks\noperator:turns\nguest:waits\n")
    return file


class Authority(NamedTuple):
    """A certificate authority, with the files of its certificates."""

    folder: Path
    signs: trustme.CA

    @property
    def ca(self) -> Path:
        file = self.folder / "ca.pem"
        self.signs.cert_pem.write_to_path(str(file))
        return file

    def files_of(self, name: str, *hosts: str) -> tuple[Path, Path]:
        issued = self.signs.issue_cert(*(hosts or (f"{name}.test",)), common_name=name)
        files = self.folder / f"{name}.pem", self.folder / f"{name}.key"
        files[0].write_bytes(b"".join(each.bytes() for each in issued.cert_chain_pems))
        files[1].write_bytes(issued.private_key_pem.bytes())
        return files

    def credentials(self, name: str, trusts: "Authority | None" = None) -> Credentials:
        certificate, key = self.files_of(name)
        return Credentials(ca=(trusts or self).ca, certificate=certificate, key=key)


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    (folder := tmp_path / "ours").mkdir()
    return Authority(folder, trustme.CA())


@pytest.fixture
def stranger(tmp_path: Path) -> Authority:
    (folder := tmp_path / "theirs").mkdir()
    return Authority(folder, trustme.CA())


@contextmanager
def served(engine: Engine, place: str, **options: Any) -> Iterator[str]:
    service = Service(engine, ServerOptions(listen=(place,), **options)).start()
    try:
        yield place
    finally:
        service.close()


def as_user(name: str, password: str) -> Credentials:
    return Credentials.model_validate({"user": name, "password": password})


def connect(place: str, credentials: Credentials | None = None) -> taxel.remote.RemoteSource:
    return taxel.connect(place, transport="zenoh", timeout=PATIENT, credentials=credentials)


def test_only_users_get_in(
    engine: Engine, start: ServerStarter, users: Path, make_windows: WindowMaker
) -> None:
    place = start(engine, users=users)
    windows = make_windows(2)
    with connect(place, as_user("robot", "walks")) as source:
        assert source.predictor("skin").predict(windows).shape == (2, 21)
    with pytest.raises(PermissionDenied, match="turns this client away, which showed user 'robot'"):
        connect(place, as_user("robot", "looks"))
    with pytest.raises(PermissionDenied, match="showed user 'nobody'"):
        connect(place, as_user("nobody", "walks"))
    with pytest.raises(PermissionDenied, match="showed no user and no certificate"):
        connect(place)

    async def asynchronous() -> None:
        right, wrong = as_user("robot", "walks"), as_user("robot", "looks")
        async with taxel.connect_async(place, transport="zenoh", credentials=right) as source:
            assert (await (await source.predictor("skin")).predict(windows)).shape == (2, 21)
        with pytest.raises(PermissionDenied):
            await taxel.connect_async(place, timeout=PATIENT, credentials=wrong)

    asyncio.run(asynchronous())


def test_a_server_with_a_certificate_is_trusted_by_its_authority_only(
    engine: Engine, endpoint: str, authority: Authority, stranger: Authority, make_windows: WindowMaker
) -> None:
    certificate, key = authority.files_of("server", "127.0.0.1")
    place = endpoint.replace("tcp/", "tls/")
    with served(engine, place, tls_certificate=certificate, tls_key=key):
        with connect(place, Credentials(ca=authority.ca)) as source:
            assert source.predictor("skin").predict(make_windows(1)).shape == (1, 21)
        with pytest.raises(PermissionDenied, match="does not trust the server's certificate"):
            connect(place, Credentials(ca=stranger.ca))
        with pytest.raises(PermissionDenied, match=r"server\.key holds no certificate"):
            connect(place, Credentials(ca=key))
        with pytest.raises(PermissionDenied, match="a well-known authority"):
            connect(place)
        with pytest.raises(PermissionDenied, match="a protocol that it takes"):
            connect(endpoint)


def test_a_certificate_for_another_host_is_not_trusted(
    engine: Engine, endpoint: str, authority: Authority
) -> None:
    certificate, key = authority.files_of("server", "elsewhere.test")
    place = endpoint.replace("tcp/", "tls/")
    with (
        served(engine, place, tls_certificate=certificate, tls_key=key),
        pytest.raises(PermissionDenied, match="does not trust the server's certificate"),
    ):
        connect(place, Credentials(ca=authority.ca))


def test_only_clients_with_a_certificate_get_in_and_do_what_its_name_may(
    engine: Engine, endpoint: str, authority: Authority, stranger: Authority, make_windows: WindowMaker
) -> None:
    certificate, key = authority.files_of("server", "127.0.0.1")
    place = endpoint.replace("tcp/", "tls/")
    options: dict[str, Any] = {
        "tls_certificate": certificate,
        "tls_key": key,
        "tls_client_ca": authority.ca,
        "allow": ("robot=infer+metadata", "visitor=metadata"),
    }
    with served(engine, place, **options):
        with connect(place, authority.credentials("robot")) as source:
            assert source.predictor("skin").predict(make_windows(1)).shape == (1, 21)
        with connect(place, authority.credentials("visitor")) as source:
            predictor = source.predictor("skin")
            with pytest.raises(PermissionDenied):
                predictor.predict(make_windows(1))
        for wrong in (Credentials(ca=authority.ca), stranger.credentials("robot", trusts=authority)):
            with pytest.raises(PermissionDenied, match="turns this client away"):
                connect(place, wrong)


def test_users_may_do_what_they_are_allowed(
    engine: Engine, start: ServerStarter, users: Path, make_windows: WindowMaker
) -> None:
    allowed = ("robot=infer", "visitor=metadata", "operator=infer+metadata+administration")
    place = start(engine, users=users, allow=allowed)
    with connect(place, as_user("operator", "turns")) as source:
        assert source.predictor("skin").predict(make_windows(1)).shape == (1, 21)
        with pytest.raises(NotFound):  # the question came through
            source.get(LOAD)
    with connect(place, as_user("robot", "walks")) as source:
        with pytest.raises(taxel.InvalidArgument):  # the question came through
            source.get(INFER, b"")
        for key in ("taxel/v2", "taxel/v2/models/skin", LOAD):
            with pytest.raises(PermissionDenied):
                source.get(key)
    with connect(place, as_user("visitor", "looks")) as source:
        assert [model.name for model in source.models()] == ["skin", "skin", "wide"]
        for key in (INFER, "taxel/v2/models/skin/versions/2/infer", LOAD):
            with pytest.raises(PermissionDenied):
                source.get(key)
    with connect(place, as_user("guest", "waits")) as source, pytest.raises(PermissionDenied):
        source.models()


def outer_address() -> str:
    """An address of this machine that is not loopback."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
            address: str = probe.getsockname()[0]
        except OSError:
            address = "127.0.0.1"
    if address.startswith("127."):
        pytest.skip("this machine has loopback only")
    return address


def test_a_server_that_anybody_reaches_says_so_in_the_log(
    engine: Engine, endpoint: str, users: Path, caplog: pytest.LogCaptureFixture
) -> None:
    everywhere = endpoint.replace("127.0.0.1", "0.0.0.0")
    with served(engine, everywhere, users=users), served(engine, endpoint.replace("127.0.0.1", "[::1]")):
        assert "may ask" not in caplog.text
    with served(engine, everywhere):
        assert f"anybody who reaches {everywhere} may ask" in caplog.text


def test_administration_is_for_loopback_unless_somebody_is_named(
    engine: Engine, endpoint: str, users: Path
) -> None:
    port = endpoint.rpartition(":")[2]
    outside = f"tcp/{outer_address()}:{port}"
    with served(engine, f"tcp/0.0.0.0:{port}"):
        with connect(endpoint) as source, pytest.raises(NotFound):
            source.get(LOAD)
        with connect(outside) as source:
            assert source.models()
            with pytest.raises(PermissionDenied):
                source.get(LOAD)
    with (
        served(engine, f"tcp/0.0.0.0:{port}", admin="any"),
        connect(outside) as source,
        pytest.raises(NotFound),
    ):
        source.get(LOAD)
    with (
        served(engine, f"tcp/0.0.0.0:{port}", users=users, allow=("operator=administration",)),
        connect(outside, as_user("operator", "turns")) as source,
        pytest.raises(NotFound),
    ):
        source.get(LOAD)


class Forger:
    """A client that declares a server's keys, with or without a server's token, and answers all."""

    def __init__(self, place: str, *, token: bool) -> None:
        self.asked: list[str] = []
        self.session = zenoh.open(client_config(place))
        for key in ("taxel/**", "**", INFER, "taxel/v2", f"taxel/@replica/{self.session.info.zid()}/**"):
            answer = Callback(self._answer, indirect=False)
            self.session.declare_queryable(key, answer, complete=True)
        if token:
            self.session.liveliness().declare_token(f"taxel/@replica/{self.session.info.zid()}")
        # The router has taken the declarations once it has answered what was sent after them.
        list(self.session.liveliness().get("taxel/@replica/*"))

    def _answer(self, query: zenoh.Query) -> None:
        self.asked.append(str(query.key_expr))
        with query:
            query.reply(query.key_expr, packb({"forged": True}))


def test_another_client_cannot_answer_for_the_server(
    engine: Engine, start: ServerStarter, make_windows: WindowMaker
) -> None:
    place = start(engine)
    forger = Forger(place, token=True)
    with forger.session, connect(place) as source:
        predictor = source.predictor("skin")
        honest = engine.model("skin", None).runtime.evaluate(make_windows(3))
        for _ in range(50):
            np.testing.assert_array_equal(predictor.predict(make_windows(3)), honest)
            assert b"forged" not in source.get("taxel/v2")
        with pytest.raises((NotFound, PermissionDenied, Unavailable)):
            source.get("taxel/v9")
    assert forger.asked == []


def test_a_client_takes_answers_of_its_server_only(endpoint: str) -> None:
    """Here the server lets everybody declare keys, as one without access control does."""
    with open_session([endpoint]):
        forger = Forger(endpoint, token=False)

        async def asynchronous() -> None:
            async with taxel.connect_async(endpoint, transport="zenoh") as source:
                with pytest.raises(Unavailable, match="its answer was refused"):
                    await source.models()

        with forger.session:
            asyncio.run(asynchronous())
            with connect(endpoint) as source, pytest.raises(Unavailable, match="which is no server"):
                source.get("taxel/v2")
    assert forger.asked


def test_credentials_come_from_the_environment_and_the_file(
    engine: Engine,
    start: ServerStarter,
    users: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    place = start(engine, users=users)
    monkeypatch.chdir(tmp_path)
    settings = tmp_path / "taxel.toml"
    settings.write_text('threads = 1\n[client]\nuser = "robot"\npassword = "walks"\n')
    with connect(place) as source:
        assert source.ready()
    monkeypatch.setenv("TAXEL_CLIENT_PASSWORD", "wrong")
    with pytest.raises(PermissionDenied):
        connect(place)
    with pytest.raises(SettingsError, match="user, password: expected both") as caught:
        settings.unlink()
        connect(place)
    assert "wrong" not in str(caught.value)
    settings.write_text('[client]\npasword = "walks"\n')
    with pytest.raises(SettingsError, match="pasword"):
        connect(place)
    assert "walks" not in repr(as_user("robot", "walks"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "expected a line USER:PASSWORD for each user"),
        ("robot:walks\nrobot", "line 2: expected USER:PASSWORD"),
        ("robot:", "line 1: expected"),
        (" robot:walks", "line 1: expected"),
        ("robot:walks\nrobot:again", "line 2: 'robot' has a line already"),
    ],
)
def test_a_wrong_file_of_users_is_told_without_its_passwords(tmp_path: Path, text: str, told: str) -> None:
    (file := tmp_path / "users").write_text(text)
    with pytest.raises(SettingsError, match=told) as caught:
        read_users(file)
    assert "walks" not in str(caught.value)


def test_rights_of_somebody_who_is_no_user_are_told(engine: Engine, endpoint: str, users: Path) -> None:
    options = ServerOptions(listen=(endpoint,), users=users, allow=("robt=infer",))
    with pytest.raises(SettingsError, match="allow: robt: expected users of"):
        Service(engine, options).start()
