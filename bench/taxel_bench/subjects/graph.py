"""What a network is compared with: torch in eager mode, and libraries that evaluate ONNX graphs."""

import onnx

from taxel.artifacts import Artifact
from taxel.errors import ArtifactError
from taxel_bench.engines import SAME_ANSWERS
from taxel_bench.operations.of_graph import count_graph_operations
from taxel_bench.peers.networks import GRAPH_PEERS
from taxel_bench.peers.peer import GraphModel
from taxel_bench.peers.selection import PeerChoice, open_peers
from taxel_bench.published_way.eager import eager_engine
from taxel_bench.published_way.networks import network_of
from taxel_bench.subjects.other_engines import OtherEngines


def engines_beside_graph(artifact: Artifact, choice: PeerChoice) -> OtherEngines:
    """The published way and the chosen peers of an artifact with an ONNX graph."""
    graph = onnx.load(artifact.model_path)
    flops, notes = _graph_operations(graph)
    found = network_of(artifact.manifest, graph.graph)
    published = None
    if found is None:
        notes.append("paper: this artifact is not of a single network of ours: there is no published way")
        model = GraphModel(artifact, graph, None, same_weights=False)
    else:
        network, same_weights = found
        if not same_weights:
            notes.append("paper: other weights of the same architecture: compares speed, not values")
        model = GraphModel(artifact, graph, network, same_weights)
        published = eager_engine(network, artifact.manifest, SAME_ANSWERS if same_weights else None)
    return OtherEngines(published, flops, notes, *open_peers(choice, GRAPH_PEERS, model))


def _graph_operations(model: onnx.ModelProto) -> tuple[int | None, list[str]]:
    """Operations of a graph, or a note on why they cannot be counted."""
    try:
        return count_graph_operations(model), []
    except ArtifactError as error:
        return None, [f"flops: {error}"]
