"""Gazebo's messages as an independent program has them, and what a world of one fingertip publishes."""

import socket
import sys
from collections.abc import Iterator
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
import zenoh

import taxel
from taxel.predictor import Predictor

PROGRAM = Path(__file__).parent / "gazebo_programs" / "stranger.py"


@pytest.fixture(scope="session")
def stranger() -> Any:
    """The program's module."""
    spec = spec_from_file_location("gazebo_stranger", PROGRAM)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def gz(stranger: Any) -> dict[str, Any]:
    """Its message classes, by full name."""
    classes: dict[str, Any] = stranger.messages()
    return classes


@pytest.fixture
def endpoint() -> str:
    """Where nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def peer(stranger: Any, endpoint: str) -> Iterator[zenoh.Session]:
    """A bare session that listens at the endpoint, as a Gazebo that was told to."""
    session = stranger.open_peer(endpoint)
    yield session
    session.close()


@pytest.fixture(scope="session")
def predictor() -> Iterator[Predictor]:
    """The shipped causal model, in this process."""
    with taxel.load() as models:
        yield models.predictor()


@pytest.fixture
def command() -> list[str]:
    """What runs the program."""
    return [sys.executable, str(PROGRAM)]
