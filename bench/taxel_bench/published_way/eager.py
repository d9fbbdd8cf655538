"""The published way for networks: torch in eager mode with gradients recorded, one thread."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from taxel.channels import CHANNELS
from taxel.manifest import Manifest
from taxel.scaling import Scaler
from taxel_bench.engines import THREADS, Engine
from taxel_bench.operations.of_network import count_network_operations
from taxel_models.families.networks.network import NetworkModel


@contextmanager
def pinned_threads() -> Iterator[None]:
    """Torch computes with as many threads as our runtime while the block lasts."""
    before = torch.get_num_threads()
    torch.set_num_threads(THREADS)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def eager_engine(model: NetworkModel, manifest: Manifest) -> Engine:
    """The network called on a tensor of z-scores: no `no_grad`, no compilation, as was published.

    Turning windows into a tensor is not timed, as it was not then. An extra input that the artifact
    does not take is fixed at its mean, 0 in z-scores.
    """
    statistics = manifest.normalisation
    inputs = Scaler.of(statistics.input_mean, statistics.input_std)
    outputs = Scaler.of(statistics.output_mean, statistics.output_std)
    network = model.network.cpu().eval()
    columns = model.shape.columns
    fixed_columns = columns - len(statistics.input_mean)

    def prepare(windows: NDArray[np.float32]) -> Tensor:
        scores = inputs.normalise(windows)
        return torch.from_numpy(np.pad(scores, ((0, 0), (0, fixed_columns))))

    return Engine(
        "paper",
        f"torch {torch.__version__}, eager, gradients recorded",
        prepare,
        network,
        lambda result: outputs.restore(result.detach().numpy()[:, : len(CHANNELS)]),
        count_network_operations(network, columns),
    )
