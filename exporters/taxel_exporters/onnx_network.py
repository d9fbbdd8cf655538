"""Writes a torch network as ONNX: raw windows in, counts out, normalisation and weights inside.

A transformer is written by `onnx_transformer`, every other network by torch's exporter.
"""

import logging
import warnings

import onnx
import torch
from torch import Tensor, nn

from taxel.channels import CHANNELS
from taxel.manifest import INPUT_NAME, OUTPUT_NAME
from taxel.protocol import MAX_ROWS
from taxel.scaling import Scaler
from taxel_exporters.onnx_file import OPSET, plain
from taxel_exporters.onnx_transformer import transformer_onnx
from taxel_models.families.networks.network import NetworkModel
from taxel_models.families.networks.transformer import TransformerHyperparameters
from taxel_models.training.trained import TrainedModel


class _Served(nn.Module):
    """The served network: `taxel.scaling` before and after it, and its first 21 outputs.

    Served extras stand behind the window. An extra that is not served is fixed at its mean, which is 0
    in z-scores.
    """

    input_mean: Tensor
    input_std: Tensor
    output_mean: Tensor
    output_std: Tensor

    def __init__(self, trained: TrainedModel, model: NetworkModel) -> None:
        super().__init__()
        self.network = model.network
        served = [extra.name for extra in trained.served_extras]
        self.length = trained.spec.length
        self.places = [served.index(name) if name in served else None for name in model.extras]
        """For each extra of the network, its index among the served extras; None if it is not served."""
        # In an ensemble, a network ignores extras that only other members take.
        self.as_served = self.places == list(range(len(served)))
        normalisation = trained.served_normalisation
        for name, scaler in (
            ("input", Scaler.of(normalisation.input_mean, normalisation.input_std)),
            ("output", Scaler.of(normalisation.output_mean, normalisation.output_std)),
        ):
            self.register_buffer(f"{name}_mean", torch.from_numpy(scaler.mean))
            self.register_buffer(f"{name}_std", torch.from_numpy(scaler.std))

    def forward(self, window: Tensor) -> Tensor:
        columns = (window - self.input_mean) / self.input_std
        if not self.as_served:
            fixed, behind = torch.zeros_like(columns[:, :1]), columns[:, self.length :]
            taken = [fixed if place is None else behind[:, place : place + 1] for place in self.places]
            columns = torch.cat([columns[:, : self.length], *taken], dim=1)
        served: Tensor = self.network(columns)[:, : len(CHANNELS)]
        return served * self.output_std + self.output_mean


def network_onnx(trained: TrainedModel) -> onnx.ModelProto:
    """The ONNX model of a trained network; its batch axis is free from 1 to 65,536."""
    fitted = trained.fitted
    assert isinstance(fitted, NetworkModel)
    if isinstance(fitted.hyperparameters, TransformerHyperparameters):
        return transformer_onnx(trained)
    served = _Served(trained, fitted).cpu().eval()
    example = torch.zeros(2, len(trained.layout.features))
    rows = torch.export.Dim("n", min=1, max=MAX_ROWS)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        # torch's exporter warns of its own deprecated parts.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            served,
            (example,),
            dynamo=True,
            opset_version=OPSET,
            input_names=[INPUT_NAME],
            output_names=[OUTPUT_NAME],
            dynamic_shapes=({0: rows},),
            verbose=False,
        )
    assert program is not None
    return plain(program.model_proto)
