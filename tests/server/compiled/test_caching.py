"""Compiled code is kept between processes, as long as none of the files that it came from changes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from taxel_server.runtimes.compiled.caching import fingerprint, forget

CALLING = """
import sys
sys.path[:0] = [sys.argv[1]]
from pathlib import Path
from taxel_server.runtimes.compiled import caching
caching._FINGERPRINT = caching.fingerprint(Path(sys.argv[1]))
import outer
value = outer.twice_called(20)
print(value, sum(outer.twice_called.stats.cache_hits.values()))
"""
OUTER = """
import numba
from inner import called
from taxel_server.runtimes.compiled.caching import fresh

@numba.njit(cache=True)
@fresh
def twice_called(x):
    return called(called(x))
"""
OUTER_OF_TYPES = """
import numba
from inner import {name}
from taxel_server.runtimes.compiled.caching import fresh

@numba.njit(cache=True)
@fresh
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


def call(folder: Path) -> tuple[int, int]:
    """What a process of its own is told, and how often the cache answered."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", CALLING, str(folder)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    value, hits = done.stdout.split()
    return int(value), int(hits)


def test_a_change_in_what_is_called_compiles_again(tmp_path: Path) -> None:
    write(tmp_path, 1)
    assert call(tmp_path) == (22, 0)
    assert call(tmp_path) == (22, 1)
    write(tmp_path, 3)
    assert call(tmp_path) == (26, 0)
    assert call(tmp_path) == (26, 1)


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
        assert call(tmp_path) == (22, 0)
        assert call(tmp_path) == (22, 1)


def test_what_another_version_left_is_removed(tmp_path: Path) -> None:
    cache = tmp_path / "deep" / "__pycache__"
    cache.mkdir(parents=True)
    kept = {"walk.walk-1f-20.py311.nbi", "walk.walk-1f-20.py311.1.nbc", "walk.cpython-311.pyc"}
    for name in {*kept, "walk.walk-2f-20.py311.nbi", "walk.walk-20.py311.1.nbc"}:
        (cache / name).touch()
    forget(tmp_path, "1f")
    assert {path.name for path in cache.iterdir()} == kept
