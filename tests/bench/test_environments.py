"""Environments of peers: made whole, made anew when half made or of other versions, refusals told."""

import json
import subprocess
from importlib.metadata import version
from pathlib import Path

import pytest

from taxel.errors import Unavailable
from taxel_bench import environments
from taxel_bench.environments import cache_folder, environment, own_versions


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "taxel" / "peers"


def test_the_cache_is_where_the_system_keeps_caches(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cache_folder() == cache
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/somewhere")
    assert cache_folder() == Path("/somewhere/.cache/taxel/peers")


def test_an_environment_is_made_once_and_is_its_own(cache: Path) -> None:
    with pytest.raises(Unavailable, match="not installed: pass --install"):
        environment("empty", [], install=False)
    interpreter = environment("empty", [], install=True)
    said = subprocess.run(
        [interpreter, "-c", "import sys; print(sys.prefix)"], capture_output=True, text=True, check=True
    )
    assert Path(said.stdout.strip()) == cache / "empty"
    made = (cache / "empty" / "requirements.json").stat().st_mtime_ns
    assert environment("empty", [], install=True) == environment("empty", [], install=False) == interpreter
    assert (cache / "empty" / "requirements.json").stat().st_mtime_ns == made


def test_other_versions_are_not_taken_for_these(cache: Path) -> None:
    environment("empty", [], install=True)
    with pytest.raises(Unavailable, match=r"installed in other versions: .*thing==2"):
        environment("empty", ["thing==2"], install=False)


def test_other_versions_are_replaced(cache: Path) -> None:
    environment("empty", [], install=True)
    (cache / "empty" / "requirements.json").write_text(json.dumps(["thing==1"]))
    (cache / "empty" / "old").touch()
    environment("empty", [], install=True)
    assert environment("empty", [], install=False)
    assert not (cache / "empty" / "old").exists()


def test_what_cannot_be_installed_is_told_and_leaves_nothing(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # pip alone, without an index: nothing is asked of any network.
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.delenv("PIP_FIND_LINKS", raising=False)
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    with pytest.raises(Unavailable, match=r"cannot be installed: .*taxel-no-such-package"):
        environment("none", ["taxel-no-such-package==1"], install=True)
    assert list(cache.iterdir()) == []


def test_a_half_made_one_is_made_again(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(folder: Path, requirements: object) -> None:
        (folder / "bin").mkdir()
        raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(environments, "_fill", interrupted)
        environment("empty", [], install=True)
    with pytest.raises(Unavailable, match="not installed"):
        environment("empty", [], install=False)
    assert environment("empty", [], install=True).is_file()


def test_own_versions_are_those_that_run_here() -> None:
    assert own_versions("numpy", "taxel-no-such-package") == [f"numpy=={version('numpy')}"]
