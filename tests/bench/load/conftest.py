"""A server process of the shipped models."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from taxel_bench.server_process import running_server
from taxel_models.shipped import shipped_repository


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    """Where a server answers that is used by nobody else meanwhile."""
    with running_server(shipped_repository()) as started:
        yield started


@pytest.fixture(scope="session")
def small_repository(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`network-b` alone, which a server has ready soonest."""
    folder = tmp_path_factory.mktemp("repository")
    shutil.copytree(shipped_repository() / "network-b", folder / "network-b")
    return folder
