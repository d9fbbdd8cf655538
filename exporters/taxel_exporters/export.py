"""Export: a trained model becomes a new version in a repository, or nothing is written."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taxel import __version__
from taxel.errors import ArtifactError
from taxel.manifest import Manifest, ModelFile, tensors
from taxel_exporters import formats
from taxel_exporters.formats import ExportedModel
from taxel_exporters.parity import check_parity
from taxel_exporters.publish import Check, free_version, publish
from taxel_exporters.rounding import check_rounding
from taxel_exporters.weights import Weights
from taxel_models.loop.inference.reference import held_out_residual
from taxel_models.training import trained as trained_models
from taxel_models.training.dataset import Examples, concatenate, examples
from taxel_models.training.trained import TrainedModel


def export(
    folder: Path,
    repository: Path,
    *,
    name: str | None = None,
    version: str | None = None,
    model_format: str | None = None,
    weights: Weights = Weights.FLOAT32,
    description: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> Manifest:
    """Export the trained model in `folder` as `<repository>/<name>/<version>`.

    The artifact is built in a temporary folder, loaded as a server would load it, and compared with the
    trained model on held-out windows. Only then is it moved into the repository.

    Args:
        name: the family's name if none is given.
        version: the next free one if none is given.
        model_format: `xgboost` or `onnx`; the family's default if none is given.
        weights: an artifact with rounded weights is compared with measurements instead; only a small
            rise of the error is accepted.
        progress: is told what takes long.

    Raises:
        ArtifactError: the trained model is damaged, the artifact's predictions differ, or rounding
            raises the error too much.
        SettingsError: the name or version is not possible, the version exists, or rounding would
            not make such a model faster.
    """
    trained = trained_models.load(folder)
    held_out = concatenate(
        [examples(recording, trained.spec) for recording in trained_models.held_out(folder)]
    )
    if not len(held_out):
        raise ArtifactError(f"{folder}: its held-out recordings give no window to check the export with")
    training = trained.record.training
    name = name or training.family
    version = free_version(repository, name, version)
    write = formats.write_int8 if weights is Weights.INT8 else formats.write
    model = write(trained, model_format)
    layout = trained.layout
    inputs, outputs = tensors(layout, spread=model.spread)
    manifest = Manifest(
        name=name,
        version=version,
        description=description
        or _describe(training.family, trained.spec.combination, training.data[0].format),
        platform=model.platform,
        inputs=inputs,
        outputs=outputs,
        window=layout,
        normalisation=trained.served_normalisation.model_copy(update={"folded": model.folded}),
        parameters=trained.record.parameters,
        training=training,
        model_file=ModelFile(
            name=model.file_name,
            sha256=hashlib.sha256(model.content).hexdigest(),
            size=len(model.content),
        ),
        taxel_version=__version__,
    )
    recordings = trained_models.held_out(folder)
    residual = held_out_residual(_Source(trained, manifest), recordings, progress=progress)
    manifest = manifest.model_copy(update={"held_out_residual": residual})
    return publish(repository, manifest, model.content, _check(name, trained, held_out, model))


@dataclass(frozen=True)
class _Source:
    """A trained model as the loop takes one, with the served extras as the last columns of windows."""

    trained: TrainedModel
    manifest: Manifest

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 21) counts of windows (n, f)."""
        count = len(self.trained.spec.features)
        names = [extra.name for extra in self.trained.served_extras]
        extras = dict(zip(names, windows[:, count:].T, strict=True))
        return self.trained.predict(windows[:, :count], extras)

    predict_base = predict


def _check(name: str, trained: TrainedModel, held_out: Examples, model: ExportedModel) -> Check:
    size = model.float32_size
    if size is None:
        return lambda staging: check_parity(staging, name, trained, held_out, model.tolerance)
    return lambda staging: check_rounding(staging, name, trained, held_out, size)


def _describe(family: str, combination: int, data: str) -> str:
    return f"A BioTac fingertip: {family} on input combination {combination}, trained on {data} data."
