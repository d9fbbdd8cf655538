"""A whole comparison: contenders started, rounds played, medians and ratios taken."""

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
from taxel_bench.compare.contenders import CHECKED_ROWS, Contender, Task, peer_contender, taxel_contender
from taxel_bench.compare.figures import Figures, median_ratios
from taxel_bench.compare.peers import Peer
from taxel_bench.compare.processes import Cores
from taxel_bench.compare.rounds import BULK_ROWS, BareRuntime, Predict, Round, play_round
from taxel_bench.environments import find_environment, install_environment
from taxel_bench.windows import random_windows
from taxel_server.engine import load_model

OURS: Final = "taxel"

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Plan:
    """What to compare.

    Attributes:
        folder: the artifact, an ONNX network.
        peers: that are asked for.
        install: whether peers that are not installed are.
        rounds: at least 1.
        seconds: of each measurement in a round.
        seed: of the windows.
        pin: whether servers and clients are kept on cores of their own.
    """

    folder: Path
    peers: Sequence[Peer]
    install: bool
    rounds: int
    seconds: float
    seed: int
    pin: bool = False


@dataclass(frozen=True)
class Comparison:
    """What came of it.

    Attributes:
        rounds: by peer, of that peer and Taxel; of Taxel alone where no peer could take part.
        skipped: peers that had no part in any round, each with the reason.
    """

    rounds: dict[str, list[Round]]
    skipped: dict[str, str]

    def figures(self) -> dict[str, Figures]:
        """Medians over a contender's rounds: Taxel's over all, then each peer's."""
        peers = [name for name in self.rounds if name != OURS]
        ours = [one.figures[OURS] for one in self._all()]
        return {OURS: Figures.median(ours)} | {name: Figures.median(self._of(name, name)) for name in peers}

    def bare(self) -> BareRuntime:
        """Medians over all rounds."""
        return BareRuntime(
            median(one.bare.one_p50_ms for one in self._all()),
            median(one.bare.bulk_p50_ms for one in self._all()),
        )

    def ratios(self) -> dict[str, dict[str, float]]:
        """Taxel's figures as multiples of each peer's, medians over the rounds of the two."""
        peers = [name for name in self.rounds if name != OURS]
        return {name: median_ratios(self._of(name, OURS), self._of(name, name)) for name in peers}

    def report(self) -> dict[str, Any]:
        """As `--json` prints it."""
        return {
            "results": [{"server": name, **asdict(figures)} for name, figures in self.figures().items()],
            "ratios": [{"peer": name, **ratio} for name, ratio in self.ratios().items()],
            "bare_runtime": asdict(self.bare()),
            "skipped": [{"peer": name, "reason": reason} for name, reason in self.skipped.items()],
        }

    def _all(self) -> list[Round]:
        return [one for rounds in self.rounds.values() for one in rounds]

    def _of(self, peer: str, contender: str) -> list[Figures]:
        return [one.figures[contender] for one in self.rounds[peer]]


def run_comparison(plan: Plan, tell: Tell) -> Comparison:
    """Start Taxel's server and, one peer after the other, play rounds of the two.

    Only these two run at a time: some peers keep a processor busy even when nobody asks them.

    Args:
        plan: what to compare.
        tell: what is being done now.

    Raises:
        SettingsError: the artifact is not an ONNX network, or there is no core for each side.
        Unavailable: Taxel's own server does not start, or someone stops answering.
    """
    rounds: dict[str, list[Round]] = {}
    skipped: dict[str, str] = {}
    with _prepared(plan) as (task, predict):
        tell("starting taxel")
        windows = np.load(task.windows)
        with taxel_contender(task) as ours:

            def play(name: str, contenders: Sequence[Contender]) -> None:
                rounds[name] = []
                for number in range(plan.rounds):
                    tell(f"{name}: round {number + 1} of {plan.rounds}")
                    rounds[name].append(play_round(number, contenders, predict, windows, plan.seconds))

            for peer in plan.peers:
                tell(f"{peer.name}: {'installing and ' if plan.install else ''}starting")
                with ExitStack() as ending:
                    try:
                        theirs = ending.enter_context(_started(peer, task, install=plan.install))
                    except Unavailable as error:
                        skipped[peer.name] = str(error)
                    else:
                        play(peer.name, [ours, theirs])
            if not rounds:
                play(OURS, [ours])
    return Comparison(rounds, skipped)


@contextmanager
def _prepared(plan: Plan) -> Iterator[tuple[Task, Predict]]:
    """Files that all contenders are given, and the bare runtime."""
    artifact = artifacts.read(plan.folder)
    manifest = artifact.manifest
    if manifest.platform != "onnxruntime_onnx":
        raise SettingsError(f"--model {plan.folder}: {manifest.platform}: the peers serve ONNX networks")
    cores = Cores.apart() if plan.pin else None
    predict = load_model(plan.folder).runtime.evaluate
    with tempfile.TemporaryDirectory(prefix="taxel-compare-") as name:
        folder = Path(name)
        shutil.copytree(plan.folder, folder / "repository" / manifest.name / manifest.version)
        windows = random_windows(manifest, BULK_ROWS, plan.seed)
        np.save(folder / "windows.npy", windows)
        counts = predict(windows[:CHECKED_ROWS])
        yield (
            Task(artifact.model_path, folder / "repository", folder / "windows.npy", counts, cores),
            predict,
        )


@contextmanager
def _started(peer: Peer, task: Task, *, install: bool) -> Iterator[Contender]:
    get = install_environment if install else find_environment
    with peer_contender(peer, get(peer.name, peer.requirements), task) as contender:
        yield contender
