"""A served network as a module of torch, made from its artifact."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import onnx
import torch
from onnx import helper, numpy_helper
from torch import Tensor, nn
from typing_extensions import override

from taxel import artifacts
from taxel.errors import ArtifactError, InvalidArgument
from taxel.local import shipped_repository
from taxel.manifest import INPUT_NAME, OUTPUT_NAME
from taxel.torch.operations import RULES
from taxel.torch.windows import newest_window

_OLDEST: Final = 18
"""The oldest ONNX operator set whose operations have the meaning that `operations` gives them."""


def load(
    name: str, version: str | None = None, *, repository: str | Path | None = None, base: bool = False
) -> "Network":
    """A network of a repository as a torch module.

    Args:
        name: of the model.
        version: the newest if none is named.
        repository: its folder; if none, the models that come with Taxel.
        base: of a corrected model, take the network without its corrections.

    Raises:
        NotFound: there is no such model or version.
        ArtifactError: the artifact is damaged, is no network, or has corrections.
    """
    folder = artifacts.folder_of(
        shipped_repository() if repository is None else Path(repository), name, version
    )
    artifact = artifacts.read(folder)
    return Network(artifact.base if base else artifact)


class _Node(NamedTuple):
    operation: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: Mapping[str, Any]


class Network(nn.Module):
    """Takes windows (n, f), raw values in m and N, and gives channels (n, 21), counts.

    It computes what a server computes, up to the rounding of float32; `double()` computes in float64. Its
    weights are buffers: they do not train. Gradients are those of the whole way, from m and N to counts.

    Args:
        artifact: a checked artifact, as `taxel.artifacts.read` gives it.

    Attributes:
        manifest: everything about the model.
        ticks: how many ticks a window needs, 10 ms apart.

    Raises:
        ArtifactError: it is no network of float32 weights; or it has corrections, which are not computed.
    """

    def __init__(self, artifact: artifacts.Artifact) -> None:
        super().__init__()
        self.manifest = artifact.manifest
        label = self.manifest.label
        if self.manifest.platform != "onnxruntime_onnx":
            raise ArtifactError(f"{label} is a model of trees: expected a network")
        if self.manifest.effects:
            names = ", ".join(effect.name for effect in self.manifest.effects)
            raise ArtifactError(f"{label} is corrected by {names}: expected base=True, or another version")
        graph = _graph(artifact.model_path)
        self._nodes = _needed(graph)
        self._whole: dict[str, Tensor] = {}
        self._buffer_of: dict[str, str] = {}
        used = {name for node in self._nodes for name in node.inputs}
        for number, constant in enumerate(graph.initializer):
            if constant.name not in used:
                continue
            values = torch.from_numpy(numpy_helper.to_array(constant).copy())
            if values.is_floating_point():
                self._buffer_of[constant.name] = f"constant_{number}"
                self.register_buffer(f"constant_{number}", values)
            else:
                self._whole[constant.name] = values
        spec = self.manifest.spec
        self.ticks = spec.look_back + spec.look_ahead + 1

    @override
    def forward(self, window: Tensor) -> Tensor:
        """Predict the channels of each window.

        Args:
            window: (n, f), columns as `manifest.window.features`.

        Raises:
            InvalidArgument: the shape is wrong.
        """
        columns = len(self.manifest.window.features)
        if window.ndim != 2 or window.shape[1] != columns:
            raise InvalidArgument(f"window has shape {tuple(window.shape)}: expected (n, {columns})")
        values: dict[str, Tensor] = {INPUT_NAME: window, **self._whole}
        values |= {name: self.get_buffer(buffer) for name, buffer in self._buffer_of.items()}
        for node in self._nodes:
            results = RULES[node.operation]([values.get(name) for name in node.inputs], node.attributes)
            outputs = (results,) if isinstance(results, Tensor) else results
            values.update(zip(node.outputs, outputs, strict=True))
        return values[OUTPUT_NAME]

    def window(self, position: Tensor, force: Tensor, extras: Tensor | None = None) -> Tensor:
        """The newest window of each fingertip, from its past.

        Args:
            position: (n, t, 3), in each sensor's frame, m: the last t ticks, 10 ms apart, the newest last;
                t is at least `ticks`. Or (n, 3), if nothing has changed for long.
            force: of the same shape, on each finger, N.
            extras: (n, e), the extra features of the model, if it has any; their defaults if not given.

        Returns:
            (n, f), for `forward`. It has gradients by positions and forces.

        Raises:
            InvalidArgument: a shape is wrong.
        """
        window = newest_window(self.manifest.spec, position, force)
        defaults = [extra.default for extra in self.manifest.window.extras]
        if extras is None:
            extras = window.new_tensor(defaults).expand(len(window), -1)
        if extras.shape != (len(window), len(defaults)):
            raise InvalidArgument(
                f"extras has shape {tuple(extras.shape)}: expected {(len(window), len(defaults))}"
            )
        return torch.cat([window, extras], dim=1)


def _graph(path: Path) -> onnx.GraphProto:
    model = onnx.load(path, load_external_data=False)
    versions = {each.domain: each.version for each in model.opset_import}
    if versions.get("", 0) < _OLDEST:
        raise ArtifactError(f"{path}: ONNX operators of version {versions}: expected at least {_OLDEST}")
    return model.graph


def _needed(graph: onnx.GraphProto) -> list[_Node]:
    """The nodes that the channels depend on, in an order of execution."""
    needed, nodes = {OUTPUT_NAME}, []
    for node in reversed(graph.node):
        if needed.isdisjoint(node.output):
            continue
        operation = f"{node.domain}.{node.op_type}" if node.domain else node.op_type
        if operation not in RULES:
            raise ArtifactError(
                f"torch does not compute the operation {operation}: expected a network with float32 weights"
            )
        needed.update(node.input)
        attributes = {each.name: helper.get_attribute_value(each) for each in node.attribute}
        nodes.append(_Node(operation, tuple(node.input), tuple(node.output), attributes))
    return nodes[::-1]
