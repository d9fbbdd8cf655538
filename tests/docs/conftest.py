"""A server of the shipped models, and what follows pages beside it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from .blocks import blocks
from .following import SERVE, Follower


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """The port of the server that README starts."""
    assert any(SERVE in block.text for block in blocks("README.md"))
    with Follower(tmp_path_factory.mktemp("server")) as starting:
        starting.shell(SERVE, "README.md", "README.md")
        yield starting.port("7447")


@pytest.fixture
def follower(server: int, tmp_path: Path) -> Iterator[Follower]:
    with Follower(tmp_path, server) as following:
        yield following
