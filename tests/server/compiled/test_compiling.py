"""Compiled code is kept between processes, as long as none of the files that it came from changes."""

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from threading import Barrier, Thread

import numba
import pytest

from taxel_server.runtimes.compiled import compiling
from taxel_server.runtimes.compiled.compiling import compiled, fingerprint

CALLING = """
import sys
sys.path[:0] = [sys.argv[1]]
from pathlib import Path
from taxel_server.runtimes.compiled import compiling
compiling._RUNTIMES = Path(sys.argv[1])
import outer
compiling.announce()
compiling.announce()
value = outer.twice_called(20)
print(value, sum(outer.twice_called.stats.cache_hits.values()), compiling.cache_folder())
"""
OUTER = """
from inner import called
from taxel_server.runtimes.compiled.compiling import compiled

@compiled
def twice_called(x):
    return called(called(x))
"""
OUTER_OF_TYPES = """
from inner import {name}
from taxel_server.runtimes.compiled.compiling import compiled

@compiled
def added(given):
    return given.x + 2

class twice_called:
    stats = added.stats
    def __new__(cls, x):
        return added({name}(x))
"""


def write(folder: Path, step: int) -> None:
    (folder / "outer.py").write_text(OUTER)
    (folder / "inner.py").write_text(
        f"import numba\n\n@numba.njit\ndef called(x):\n    return x + {step}\n"
    )


def call(folder: Path, prepare: Callable[[], None] | None = None, **variables: str) -> tuple[int, int, str]:
    """What a process of its own is told, how often the cache answered, and where the cache is."""
    value, hits, place = run(folder, prepare, **variables).stdout.split()
    return int(value), int(hits), place


def run(
    folder: Path, prepare: Callable[[], None] | None = None, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Calls the compiled function in a process of its own."""
    environment = os.environ | {"XDG_CACHE_HOME": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)
    return subprocess.run(
        [sys.executable, "-c", CALLING, str(folder)],
        env=environment | variables,
        preexec_fn=prepare,
        capture_output=True,
        text=True,
        check=True,
    )


def test_a_change_in_what_is_called_compiles_again(tmp_path: Path) -> None:
    write(tmp_path, 1)
    assert call(tmp_path)[:2] == (22, 0)
    assert call(tmp_path)[:2] == (22, 1)
    write(tmp_path, 3)
    assert call(tmp_path)[:2] == (26, 0)
    assert call(tmp_path)[:2] == (26, 1)


@pytest.mark.parametrize("name", ["deep/one.py", "deep/two.py"])
def test_the_fingerprint_is_of_names_and_content(tmp_path: Path, name: str) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "one.py").write_text("1")
    before = fingerprint(tmp_path)
    assert fingerprint(tmp_path) == before
    (tmp_path / name).write_text("2")
    assert fingerprint(tmp_path) != before


def test_a_type_that_is_gone_is_not_asked_for(tmp_path: Path) -> None:
    for name in ("Before", "After"):
        (tmp_path / "inner.py").write_text(
            f"from typing import NamedTuple\n\nclass {name}(NamedTuple):\n    x: int\n"
        )
        (tmp_path / "outer.py").write_text(OUTER_OF_TYPES.format(name=name))
        assert call(tmp_path)[:2] == (22, 0)
        assert call(tmp_path)[:2] == (22, 1)


def test_the_users_own_cache_folder_is_respected(tmp_path: Path) -> None:
    write(tmp_path, 1)
    own = tmp_path / "own"
    assert Path(call(tmp_path, NUMBA_CACHE_DIR=str(own))[2]).parent == own
    assert call(tmp_path, NUMBA_CACHE_DIR=str(own))[:2] == (22, 1)
    assert not (tmp_path / "cache").exists()


def test_where_nothing_can_be_written_every_process_compiles(tmp_path: Path) -> None:
    write(tmp_path, 1)
    (tmp_path / "no folder").touch()
    for _ in range(2):
        assert call(tmp_path, XDG_CACHE_HOME=str(tmp_path / "no folder")) == (22, 0, "None")
    assert not list(tmp_path.rglob("*.nb?"))


def test_a_user_without_a_home_compiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(Path, "home", no_home)
    assert compiling.cache_folder.__wrapped__() is None
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert compiling.cache_folder.__wrapped__() == tmp_path / f"compiled-{fingerprint(compiling._RUNTIMES)}"


def test_on_a_full_disk_every_process_compiles(tmp_path: Path) -> None:
    write(tmp_path, 1)

    def no_room() -> None:
        # Files can be made, and nothing can be written to them.
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    for _ in range(2):
        assert call(tmp_path, prepare=no_room) == (22, 0, "None")


def test_on_a_disk_that_is_nearly_full_every_process_compiles(tmp_path: Path) -> None:
    """Unless what it needs is there already."""
    write(tmp_path, 1)

    def little_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2**22, 2**22))

    assert call(tmp_path, prepare=little_room) == (22, 0, "None")
    assert call(tmp_path)[:2] == (22, 0)
    kept = next(tmp_path.rglob("*.nbc"))
    (kept.parent / "large.nbc").write_bytes(bytes(2**24))
    assert call(tmp_path, prepare=little_room)[:2] == (22, 1)


def test_threads_that_compile_leave_the_users_setting() -> None:
    before = numba.config.CACHE_DIR
    together, kept = Barrier(8), []

    def decorate() -> None:
        together.wait()
        for _ in range(20):
            function = compiled(lambda x: x + 1)
            kept.append(Path(function._cache.cache_path).parent)  # type: ignore[attr-defined]

    threads = [Thread(target=decorate) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert before == numba.config.CACHE_DIR
    assert set(kept) == {compiling.cache_folder()}


def test_who_waits_for_a_compilation_is_told_once(tmp_path: Path) -> None:
    write(tmp_path, 1)
    assert run(tmp_path).stderr.count("the first start of this version compiles") == 1
    assert run(tmp_path).stderr == ""
    (tmp_path / "no folder").touch()
    for _ in range(2):
        told = run(tmp_path, XDG_CACHE_HOME=str(tmp_path / "no folder")).stderr
        assert told.count("every start compiles") == 1


def test_who_only_lists_models_is_told_nothing(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "taxel", "models"],
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": ""},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "READY" in done.stdout
    assert done.stderr == ""


def test_a_second_process_compiles_no_kernel_again(tmp_path: Path) -> None:
    code = """
from taxel_server.runtimes.trees.few_rows import kernels
from taxel_server.runtimes.trees.many_rows import leaf_sums, traversal
from taxel_server.runtimes.trees.simd.lookups import can_look_up
for number_bytes in (1, 2):
    traversal.find_exits(number_bytes, 64)
leaf_sums.add_leaves(64)
if can_look_up():
    kernels.find_exits(16, 8, False, True), kernels.add_blocks(16, True), kernels.put_exits()
"""
    kept = []
    for _ in range(2):
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        subprocess.run([sys.executable, "-c", code], env=environment, check=True)
        kept.append({(path.name, path.stat().st_mtime_ns) for path in tmp_path.rglob("*.nbc")})
    assert kept[0]
    assert kept[0] == kept[1]
