"""The published way for networks: torch in eager mode with gradients recorded, one thread."""

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from taxel.channels import CHANNELS
from taxel.manifest import Manifest
from taxel.scaling import Scaler
from taxel_bench.engines import PUBLISHED, Engine
from taxel_bench.operations.of_network import count_network_operations
from taxel_models.families.networks.network import NetworkModel

Prepare = Callable[[NDArray[np.float32]], Tensor]
Counts = Callable[[Tensor], NDArray[np.float32]]


def network_scaling(model: NetworkModel, manifest: Manifest) -> tuple[Prepare, Counts, int]:
    """Raw windows to a tensor of z-scores, a tensor of z-scores to counts, and the network's columns.

    An extra input that the artifact does not take is fixed at its mean, 0 in z-scores.
    """
    statistics = manifest.normalisation
    inputs = Scaler.of(statistics.input_mean, statistics.input_std)
    outputs = Scaler.of(statistics.output_mean, statistics.output_std)
    columns = model.shape.columns
    fixed_columns = columns - len(statistics.input_mean)

    def prepare(windows: NDArray[np.float32]) -> Tensor:
        scores = inputs.normalise(windows)
        return torch.from_numpy(np.pad(scores, ((0, 0), (0, fixed_columns))))

    def counts(result: Tensor) -> NDArray[np.float32]:
        return outputs.restore(result.detach().numpy()[:, : len(CHANNELS)])

    return prepare, counts, columns


def eager_engine(model: NetworkModel, manifest: Manifest, tolerance: float | None) -> Engine:
    """The network called on a tensor of z-scores: no `no_grad`, no compilation, as was published.

    Turning windows into a tensor is not timed, as it was not then.
    """
    prepare, counts, columns = network_scaling(model, manifest)
    network = model.network.cpu().eval()
    return Engine(
        PUBLISHED,
        f"torch {torch.__version__}, eager, gradients recorded",
        prepare,
        network,
        counts,
        count_network_operations(network, columns),
        tolerance,
    )
