"""Compiled code is kept between processes, as long as none of the files that it came from changes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from taxel_server.runtimes.compiled.caching import fingerprint, fresh

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


def test_the_function_itself_stays_as_it_is() -> None:
    factor = 3

    def scaled(x: int, offset: int = 1) -> int:
        """Says what it does."""
        return x * factor + offset

    closing = fresh(scaled)
    assert (closing.__name__, closing.__doc__, closing.__defaults__) == ("scaled", scaled.__doc__, (1,))
    assert [cell.cell_contents for cell in closing.__closure__ or ()][:-1] == [factor]
