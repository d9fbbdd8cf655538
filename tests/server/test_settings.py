"""Where options come from, and that a wrong one is told in one line."""

from pathlib import Path
from typing import Any

import pytest

from taxel.errors import SettingsError
from taxel_server.settings import read_settings


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_defaults() -> None:
    settings = read_settings({"repository": Path("models")})
    assert settings.listen == ("tcp/127.0.0.1:7447",)
    assert (settings.prefix, settings.max_batch_rows, settings.threads) == ("taxel", 1024, 1)


def test_the_command_line_beats_the_environment_beats_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("taxel.toml").write_text(
        'threads = 2\nmax_batch_rows = 2\nprefix = "file"\nlisten = ["tcp/a:1", "tcp/b:2"]\n'
    )
    monkeypatch.setenv("TAXEL_THREADS", "3")
    monkeypatch.setenv("TAXEL_MAX_BATCH_ROWS", "3")
    settings = read_settings({"repository": Path("models"), "threads": 4})
    assert (settings.threads, settings.max_batch_rows, settings.prefix) == (4, 3, "file")
    assert settings.listen == ("tcp/a:1", "tcp/b:2")


def test_the_environment_names_several_endpoints(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAXEL_LISTEN", "tcp/127.0.0.1:1, udp/[::1]:2")
    assert read_settings({"repository": Path("models")}).listen == ("tcp/127.0.0.1:1", "udp/[::1]:2")


def test_variables_of_other_parts_are_let_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAXEL_DATA", "/recordings")
    assert read_settings({"repository": Path("models")}).repository == Path("models")


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"threads": 0}, "threads"),
        ({"max_batch_rows": 0}, "max_batch_rows"),
        ({"drain_seconds": -1}, "drain_seconds"),
        ({"prefix": "a//b"}, "prefix"),
        ({"prefix": "taxel/**"}, "prefix"),
        ({"listen": ()}, "listen"),
        ({"listen": ("localhost",)}, "listen.*'localhost': expected PROTOCOL/ADDRESS"),
        ({"listen": ("tcp/127.0.0.1:0",)}, "listen.*expected a port"),
        ({"tls_key": Path("key")}, "tls_certificate, tls_key: expected both"),
        ({"listen": ("tls/a:1",)}, "listen: expected tls/HOST:PORT with tls_certificate"),
        ({"tls_certificate": Path("c"), "tls_key": Path("k")}, "listen: expected tls/HOST:PORT"),
        (
            {
                "listen": ("tls/a:1", "tcp/a:2"),
                "tls_certificate": Path("c"),
                "tls_key": Path("k"),
                "tls_client_ca": Path("ca"),
            },
            "tls_client_ca: expected tls/HOST:PORT only",
        ),
        ({"allow": ("robot=infer",)}, "allow: expected users or tls_client_ca"),
        ({"users": Path("u"), "allow": ("robot=look",)}, "'robot=look': expected NAME=RIGHT"),
        ({"users": Path("u"), "allow": ("robot=",)}, "'robot=': expected NAME=RIGHT"),
        ({"users": Path("u"), "allow": ("robot=infer", "robot=metadata")}, "a name is given twice"),
        ({"users": Path("u"), "lane": "tcp:127.0.0.1:9"}, "any user of the machine may ask there"),
        (
            {"max_request_rows": 9, "max_queue_rows": 8},
            "max_request_rows 9: expected at most max_queue_rows",
        ),
    ],
)
def test_a_wrong_value_is_named(given: dict[str, Any], named: str) -> None:
    with pytest.raises(SettingsError, match=named) as caught:
        read_settings({"repository": Path("models"), **given})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "named"), [("treads = 2", "treads"), ("threads", "taxel.toml"), ('threads = "two"', "threads")]
)
def test_a_wrong_file_is_told(text: str, named: str) -> None:
    Path("taxel.toml").write_text(text)
    with pytest.raises(SettingsError, match=named):
        read_settings({"repository": Path("models")})


def test_a_wrong_variable_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAXEL_MAX_QUEUE_ROWS", "many")
    with pytest.raises(SettingsError, match="max_queue_rows"):
        read_settings({"repository": Path("models")})
