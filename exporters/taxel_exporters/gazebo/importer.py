"""Import: a network of the Gazebo plugin becomes a new version in a repository, or nothing is written."""

import hashlib
from pathlib import Path
from typing import Final

import numpy as np

from taxel import __version__
from taxel.manifest import (
    Imported,
    Manifest,
    ModelFile,
    Normalisation,
    WindowLayout,
    tensors,
)
from taxel.windows import ExtraFeature
from taxel_exporters.gazebo.columns import CHANNEL_COLUMNS, FEATURE_COLUMNS, INPUTS, SPEC, TEMPERATURE
from taxel_exporters.gazebo.document import read_content
from taxel_exporters.gazebo.graph import network_onnx
from taxel_exporters.gazebo.model_file import read_network
from taxel_exporters.gazebo.network import Dense, Network
from taxel_exporters.gazebo.parity import check_parity
from taxel_exporters.publish import free_version, publish

FORMAT: Final = "gazebo-plugin"


def import_network(
    path: Path,
    repository: Path,
    *,
    name: str,
    version: str | None = None,
    description: str | None = None,
) -> Manifest:
    """Import a `model.yaml` as `<repository>/<name>/<version>`.

    The served model takes windows of input combination 1 and the temperature `tdc`. If `tdc` is not given,
    its mean is used. The model gives the 21 channels.

    Args:
        version: the next free one if none is given.

    Raises:
        ArtifactError: the file is refused, or the artifact's predictions differ from the network's.
        SettingsError: the name or version is not possible, or the version exists.
    """
    version = free_version(repository, name, version)
    source = read_content(path)
    network = read_network(source, str(path))
    content = network_onnx(network).SerializeToString(deterministic=True)
    mean = network.inputs.mean[INPUTS.index(TEMPERATURE)]
    layout = WindowLayout.of(SPEC, (ExtraFeature(name=TEMPERATURE, unit="counts", default=mean),))
    inputs, outputs = tensors(layout)
    manifest = Manifest(
        name=name,
        version=version,
        description=description or _describe(network),
        platform="onnxruntime_onnx",
        inputs=inputs,
        outputs=outputs,
        window=layout,
        normalisation=Normalisation(
            input_mean=_chosen(network.inputs.mean, FEATURE_COLUMNS),
            input_std=_chosen(network.inputs.std, FEATURE_COLUMNS),
            output_mean=_chosen(network.outputs.mean, CHANNEL_COLUMNS),
            output_std=_chosen(network.outputs.std, CHANNEL_COLUMNS),
            folded=True,
        ),
        parameters=network.parameters,
        training=None,
        imported=Imported(format=FORMAT, file=path.name, sha256=hashlib.sha256(source).hexdigest()),
        model_file=ModelFile(
            name="model.onnx", sha256=hashlib.sha256(content).hexdigest(), size=len(content)
        ),
        taxel_version=__version__,
    )
    return publish(
        repository,
        manifest,
        content,
        lambda staging: {"parity": check_parity(staging, name, network)},
    )


def _chosen(values: tuple[float, ...], columns: tuple[int, ...]) -> tuple[float, ...]:
    return tuple(np.asarray(values)[list(columns)].tolist())


def _describe(network: Network) -> str:
    dense = sum(isinstance(layer, Dense) for layer in network.layers)
    return f"A BioTac fingertip: a network of {dense} dense layers, trained for the Gazebo BioTac plugin."
