"""What a forest is compared with: its boosters one after another, and libraries that evaluate trees."""

from typing import Final

from taxel.artifacts import Artifact
from taxel_bench.peers.forests import FOREST_PEERS
from taxel_bench.peers.peer import ForestModel
from taxel_bench.peers.selection import PeerChoice, open_peers
from taxel_bench.published_way.regressors import Regressors
from taxel_bench.subjects.other_engines import OtherEngines
from taxel_bench.windows import random_windows

_OPERATION_WINDOWS: Final = 64
"""Over which the operations of trees are averaged."""


def engines_beside_forest(artifact: Artifact, choice: PeerChoice) -> OtherEngines:
    """The published way and the chosen peers of an artifact with trees."""
    manifest = artifact.manifest
    regressors = Regressors(artifact.model_path, manifest)
    windows = random_windows(manifest, _OPERATION_WINDOWS, seed=0)[:, : manifest.window.model_columns]
    published = regressors.engine(windows)
    model = ForestModel(artifact, regressors.boosters, choice.install)
    return OtherEngines(published, published.flops, [], *open_peers(choice, FOREST_PEERS, model))
