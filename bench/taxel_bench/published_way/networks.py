"""The torch network behind an ONNX artifact: its architecture, and its weights if they can be read."""

from typing import Final

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from taxel.manifest import Manifest
from taxel_models.families.networks.network import NetworkFamily, NetworkModel
from taxel_models.families.registry import FAMILIES, family, resolve

_PREFIX: Final = "network."
"""Before a parameter's name in files that torch's exporter wrote."""


def network_of(manifest: Manifest, graph: onnx.GraphProto) -> tuple[NetworkModel, bool] | None:
    """The network that an artifact was exported from, and whether it has the artifact's weights.

    The weights are read from the graph. This fails if the exporter has rearranged or rounded them. Then the
    seed gives the weights: an untrained artifact has the same ones; any other is as fast with other values.

    Returns:
        None where the artifact was not exported from a single network of ours.
    """
    training = manifest.training
    if training is None or training.family not in FAMILIES:
        return None
    kind = family(training.family)
    if not isinstance(kind, NetworkFamily):
        return None
    chosen = resolve(kind, manifest.window.combination, training.hyperparameters)
    networks = []
    # With the extras first: a network without them would fit a part of the same weights.
    for extras in (kind.extras, ()) if kind.extras else ((),):
        shape = kind.shape(manifest.spec, extras)
        torch.manual_seed(training.seed)
        network = kind.build(shape, chosen)
        networks.append(NetworkModel(network, shape, chosen))
        state = _weights_in(graph, network)
        if state is not None:
            network.load_state_dict(state)
            return networks[-1], True
    return networks[0], not training.data


def _weights_in(graph: onnx.GraphProto, network: nn.Module) -> dict[str, Tensor] | None:
    """The network's state as the graph holds it, or None where a part is missing or of another shape."""
    constants = {constant.name: constant for constant in graph.initializer}
    state = {}
    for name, parameter in network.state_dict().items():
        constant = constants.get(_PREFIX + name)
        if constant is None or tuple(constant.dims) != tuple(parameter.shape):
            return None
        state[name] = torch.tensor(numpy_helper.to_array(constant))
    return state
