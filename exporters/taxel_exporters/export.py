"""Export: a trained model becomes a new version in a repository, or nothing is written."""

import hashlib
from pathlib import Path
from typing import Any

import taxel
from taxel import __version__
from taxel.errors import ArtifactError
from taxel.manifest import Manifest, ModelFile, Parity, RoundedWeights, tensors
from taxel_exporters import formats
from taxel_exporters.formats import ExportedModel
from taxel_exporters.parity import check_parity
from taxel_exporters.publish import free_version, publish
from taxel_exporters.rounding import check_rounding
from taxel_exporters.weights import Weights
from taxel_models.loop.reference.held_out import held_out_residual
from taxel_models.loop.status import StatusCallback, silent
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
    progress: StatusCallback = silent,
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
    recordings = trained_models.held_out(folder)
    held_out = concatenate([examples(recording, trained.spec) for recording in recordings])
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

    def check(staging: Path) -> dict[str, Any]:
        found = _check(staging, name, trained, held_out, model)
        # A forest's artifact predicts many times as fast as the library that trained it.
        with taxel.load(staging) as source:
            residual = held_out_residual(
                source.predictor(name),
                trained_models.reference(folder),
                trained_models.fitted(folder),
                progress=progress,
            )
        return {**found, "held_out_residual": residual}

    return publish(repository, manifest, model.content, check)


def _check(
    staging: Path, name: str, trained: TrainedModel, held_out: Examples, model: ExportedModel
) -> dict[str, Parity | RoundedWeights]:
    size = model.float32_size
    if size is None:
        return {"parity": check_parity(staging, name, trained, held_out, model.tolerance)}
    return {"rounded_weights": check_rounding(staging, name, trained, held_out, size)}


def _describe(family: str, combination: int, data: str) -> str:
    return f"A BioTac fingertip: {family} on input combination {combination}, trained on {data} data."
