"""The peers: pinned, known by name, and every program that they name exists."""

from importlib.metadata import version
from pathlib import Path

import pytest

from taxel.errors import SettingsError
from taxel_bench.compare import peer_programs
from taxel_bench.compare.peers import PEERS, parse_peers

PROGRAMS = {path.stem for path in Path(str(peer_programs.__file__)).parent.glob("*.py")}


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_a_peer_is_pinned_and_has_its_programs(peer: object) -> None:
    assert {peer.server, peer.client} <= PROGRAMS
    assert all("==" in requirement for requirement in peer.requirements)
    assert f"onnxruntime=={version('onnxruntime')}" in peer.requirements


def test_peers_are_read_in_the_order_given() -> None:
    assert [peer.name for peer in parse_peers("grpc, fastapi,grpc")] == ["grpc", "fastapi"]


def test_an_unknown_peer_is_named() -> None:
    with pytest.raises(SettingsError, match="no peer 'triton'; there is: fastapi, litserve"):
        parse_peers("fastapi,triton")
