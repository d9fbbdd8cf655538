"""A whole comparison: servers started, rounds measured, medians and ratios taken."""

import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from taxel import artifacts
from taxel.errors import SettingsError, Unavailable
from taxel_bench.compare.figures import Figures, median_ratios
from taxel_bench.compare.peers import PeerServer
from taxel_bench.compare.processes import Cores
from taxel_bench.compare.rounds import BULK_ROWS, BareRuntime, Predict, Round, measure_round
from taxel_bench.compare.servers import (
    CHECKED_ROWS,
    LANE,
    ZENOH,
    ServerUnderTest,
    Workload,
    peer_server,
    taxel_servers,
)
from taxel_bench.environments import environment
from taxel_bench.windows import random_windows
from taxel_server.engine import load_model

OURS: Final = (ZENOH, LANE)

Tell = Callable[[str], None]


@dataclass(frozen=True)
class CompareSettings:
    """What to compare.

    Attributes:
        folder: the artifact, an ONNX network.
        peers: that are asked for.
        install: whether peers that are not installed are.
        rounds: at least 1.
        seconds: of each measurement in a round.
        seed: of the windows.
        pin: whether servers and clients are kept on cores of their own.
        gaps_ms: pauses between an answer and the next query.
    """

    folder: Path
    peers: Sequence[PeerServer]
    install: bool
    rounds: int
    seconds: float
    seed: int
    pin: bool = False
    gaps_ms: Sequence[float] = ()


@dataclass(frozen=True)
class Comparison:
    """What came of it.

    Attributes:
        rounds: by peer, of that peer and Taxel's two; of Taxel alone where no peer could take part.
        skipped: peers that had no part in any round, each with the reason.
    """

    rounds: dict[str, list[Round]]
    skipped: dict[str, str]

    def figures(self) -> dict[str, Figures]:
        """Medians over a server's rounds: Taxel's two over all, then each peer's."""
        ours = {name: Figures.median([each.figures[name] for each in self._all()]) for name in OURS}
        return ours | {name: Figures.median(self._of(name, name)) for name in self._peers()}

    def bare(self) -> BareRuntime:
        """Medians over all rounds."""
        return BareRuntime(
            median(each.bare.one_p50_ms for each in self._all()),
            median(each.bare.bulk_p50_ms for each in self._all()),
        )

    def ratios(self) -> dict[tuple[str, str], dict[str, Any]]:
        """Taxel's figures as multiples of each peer's, by the two names: medians over their rounds."""
        return {
            (ours, name): median_ratios(self._of(name, ours), self._of(name, name))
            for name in self._peers()
            for ours in OURS
        }

    def report(self) -> dict[str, Any]:
        """As `--json` prints it."""
        return {
            "results": [{"server": name, **asdict(figures)} for name, figures in self.figures().items()],
            "ratios": [
                {"server": ours, "peer": name, **ratio} for (ours, name), ratio in self.ratios().items()
            ],
            "bare_runtime": asdict(self.bare()),
            "skipped": [{"peer": name, "reason": reason} for name, reason in self.skipped.items()],
        }

    def _peers(self) -> list[str]:
        return [name for name in self.rounds if name != ZENOH]

    def _all(self) -> list[Round]:
        return [each for rounds in self.rounds.values() for each in rounds]

    def _of(self, peer: str, server: str) -> list[Figures]:
        return [each.figures[server] for each in self.rounds[peer]]


def run_comparison(settings: CompareSettings, tell: Tell) -> Comparison:
    """Start Taxel's server and, one peer after the other, measure rounds of the two.

    Only these two run at a time: some peers keep a processor busy even when nobody asks them.

    Args:
        settings: what to compare.
        tell: what is being done now.

    Raises:
        SettingsError: the artifact is not an ONNX network, or there is no core for each side.
        Unavailable: Taxel's own server does not start, or someone stops answering.
    """
    rounds: dict[str, list[Round]] = {}
    skipped: dict[str, str] = {}
    with _prepared(settings) as (workload, predict):
        tell("starting taxel")
        windows = np.load(workload.windows)
        with taxel_servers(workload) as ours:

            def measure_rounds(name: str, servers: Sequence[ServerUnderTest]) -> None:
                rounds[name] = []
                for number in range(settings.rounds):
                    tell(f"{name}: round {number + 1} of {settings.rounds}")
                    rounds[name].append(
                        measure_round(number, servers, predict, windows, settings.seconds, settings.gaps_ms)
                    )

            for peer in settings.peers:
                tell(f"{peer.name}: {'installing and ' if settings.install else ''}starting")
                with ExitStack() as ending:
                    try:
                        theirs = ending.enter_context(_started(peer, workload, install=settings.install))
                    except Unavailable as error:
                        skipped[peer.name] = str(error)
                    else:
                        measure_rounds(peer.name, [*ours, theirs])
            if not rounds:
                measure_rounds(ZENOH, ours)
    return Comparison(rounds, skipped)


@contextmanager
def _prepared(settings: CompareSettings) -> Iterator[tuple[Workload, Predict]]:
    """Files that all servers are given, and the bare runtime."""
    artifact = artifacts.read(settings.folder)
    manifest = artifact.manifest
    if manifest.platform != "onnxruntime_onnx":
        raise SettingsError(
            f"--model {settings.folder}: {manifest.platform}: the peers serve ONNX networks"
        )
    cores = Cores.apart() if settings.pin else None
    predict = load_model(settings.folder).runtime.evaluate
    with tempfile.TemporaryDirectory(prefix="taxel-compare-") as name:
        folder = Path(name)
        shutil.copytree(settings.folder, folder / "repository" / manifest.name / manifest.version)
        windows = random_windows(manifest, BULK_ROWS, settings.seed)
        np.save(folder / "windows.npy", windows)
        counts = predict(windows[:CHECKED_ROWS])
        yield (
            Workload(artifact.model_path, folder / "repository", folder / "windows.npy", counts, cores),
            predict,
        )


@contextmanager
def _started(peer: PeerServer, workload: Workload, *, install: bool) -> Iterator[ServerUnderTest]:
    interpreter = environment(f"servers/{peer.name}", peer.requirements, install=install)
    with peer_server(peer, interpreter, workload) as server:
        yield server
