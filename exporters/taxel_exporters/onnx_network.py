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

    If the temperature is served, it is the window's last column. Otherwise it is fixed at its mean, which
    is 0 in z-scores.
    """

    input_mean: Tensor
    input_std: Tensor
    output_mean: Tensor
    output_std: Tensor

    def __init__(self, trained: TrainedModel, model: NetworkModel) -> None:
        super().__init__()
        self.network = model.network
        self.fixed_temperature = model.takes_temperature and not trained.serves_temperature
        # Beside others in an ensemble, a network without temperature leaves that column alone.
        self.ignored_temperature = trained.serves_temperature and not model.takes_temperature
        normalisation = trained.served_normalisation
        for name, scaler in (
            ("input", Scaler.of(normalisation.input_mean, normalisation.input_std)),
            ("output", Scaler.of(normalisation.output_mean, normalisation.output_std)),
        ):
            self.register_buffer(f"{name}_mean", torch.from_numpy(scaler.mean))
            self.register_buffer(f"{name}_std", torch.from_numpy(scaler.std))

    def forward(self, window: Tensor) -> Tensor:
        columns = (window - self.input_mean) / self.input_std
        if self.ignored_temperature:
            columns = columns[:, :-1]
        if self.fixed_temperature:
            columns = torch.cat([columns, torch.zeros_like(columns[:, :1])], dim=1)
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
