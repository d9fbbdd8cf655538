"""Which peers take part, and the engines of those that can."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from taxel.errors import Unavailable
from taxel_bench.engines import Engine
from taxel_bench.options import parse_names
from taxel_bench.peers.peer import Model, Peer, reason_of
from taxel_bench.windows import random_windows

ALL: Final = "all"


@dataclass(frozen=True)
class PeerChoice:
    """The peers that a user has asked for.

    Attributes:
        names: None for all that there are for the model.
        install: whether packages that are not installed are.
    """

    names: tuple[str, ...] | None
    install: bool = False


NO_PEERS: Final = PeerChoice(())


def parse_peer_choice(text: str, *, install: bool) -> PeerChoice:
    """Peers from `all` or `onnxruntime,openvino`.

    Raises:
        SettingsError: there is no such peer, of trees or networks.
    """
    if text == ALL:
        return PeerChoice(None, install)
    from taxel_bench.peers.forests import FOREST_PEERS
    from taxel_bench.peers.networks import GRAPH_PEERS

    known = (peer.name for peer in (*FOREST_PEERS, *GRAPH_PEERS))
    return PeerChoice(tuple(parse_names("--peers", text, known, "peer")), install)


def open_peers(
    choice: PeerChoice, peers: Sequence[Peer[Model]], model: Model
) -> tuple[tuple[Engine, ...], dict[str, str]]:
    """Engines of the chosen peers, and the reason for each that has none or cannot evaluate a window."""
    window = random_windows(model.artifact.manifest, 1, seed=0)
    engines: list[Engine] = []
    skipped: dict[str, str] = {}
    known = {peer.name: peer for peer in peers}
    for name in known if choice.names is None else choice.names:
        try:
            if name not in known:
                raise Unavailable(f"not for this kind of model: there is {', '.join(known)}")
            known[name].get_ready(install=choice.install)
            engine = known[name].engine(model)
            # Some compile only now. A library may raise anything, and the others are measured all the same.
            engine.predict(window)
            engines.append(engine)
        except Exception as error:
            skipped[name] = reason_of(error)
    return tuple(engines), skipped
