"""Export of a correction: the same model file with effects, as a new version beside the old."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

import taxel
from taxel import artifacts
from taxel.artifacts import Artifact, manifest_json
from taxel.channels import CHANNELS
from taxel.corrections import AppliedEffect, Correction
from taxel.errors import ArtifactError, InvalidArgument
from taxel.manifest import Manifest, Parity, WindowLayout, tensors
from taxel.windows import ExtraFeature, WindowSpec
from taxel_exporters.publish import free_version, publish

TOLERANCE: Final = 0.01
"""Largest difference allowed between served and offline, counts: the served model rounds to float32."""


def export_corrected(
    repository: Path,
    name: str,
    version: str | None,
    effects: Sequence[AppliedEffect],
    extras: Sequence[ExtraFeature] = (),
    *,
    windows: NDArray[np.float32],
    description: str | None = None,
) -> Manifest:
    """Add effects to a version of a model, as the next free version of it.

    Effects of a version that is corrected already stay, and the new ones come behind them. All
    terms are computed from the prediction of the model file itself; a new frame turns windows
    before the former ones do, and shifts add up.

    Args:
        version: which one to correct; the newest if none is given.
        effects: to add, in the order in which they were found.
        extras: that the effects take, `taken_by` the effects; those that the version has already
            are not repeated.
        windows: to check the served artifact on; (n, f), n above 0, as the new version takes
            them, or without the last extras, which then take their defaults.
        description: the old one's if none is given.

    Raises:
        ArtifactError: the old version is damaged, the new one is inconsistent, or what is served
            differs from base prediction and effects computed offline.
        NotFound: there is no such model or version.
    """
    base = artifacts.read(artifacts.folder_of(repository, name, version))
    manifest = _corrected(base.manifest, free_version(repository, name, None), effects, extras, description)
    return publish(
        repository,
        manifest,
        base.model_path.read_bytes(),
        lambda staging: _check_parity(staging, manifest, base, windows),
    )


def _corrected(
    base: Manifest,
    version: str,
    effects: Sequence[AppliedEffect],
    extras: Sequence[ExtraFeature],
    description: str | None,
) -> Manifest:
    everything = (*base.effects, *effects)
    known = base.window.extras
    new = tuple(extra for extra in extras if extra not in known)
    shift = sum(effect.shift_ticks for effect in everything)
    changes = {
        "version": version,
        "description": description or base.description,
        "effects": everything,
        "parity": None,
        "taxel_version": taxel.__version__,
    }
    try:
        layout = WindowLayout.of(WindowSpec.of(base.window.combination, shift), known + new)
        return _with_window(base, layout, changes)
    except (InvalidArgument, ValidationError) as error:
        reason = artifacts.describe(error) if isinstance(error, ValidationError) else str(error)
        raise ArtifactError(f"{base.name}/{base.version} cannot be corrected so: {reason}") from None


def _with_window(base: Manifest, layout: WindowLayout, changes: Mapping[str, object]) -> Manifest:
    """The manifest with another window, checked like one that is read."""
    inputs, outputs = tensors(layout, spread=base.gives_spread)
    fields = {field: getattr(base, field) for field in Manifest.model_fields}
    return Manifest.model_validate(
        {**fields, "window": layout, "inputs": inputs, "outputs": outputs, **changes}
    )


def _check_parity(
    staging: Path, manifest: Manifest, base: Artifact, windows: NDArray[np.float32]
) -> Parity:
    """Compare what is served with the model file's own prediction and the effects, added offline."""
    with taxel.load(staging) as source:
        served = source.predictor(manifest.name)
        inputs = served.checked(windows)
        found = served.predict(inputs)
    with tempfile.TemporaryDirectory() as folder:
        bare = _write_bare(Path(folder), base)
        with taxel.load(Path(folder)) as source:
            correction = Correction(manifest.effects, manifest.spec, manifest.window.extras)
            expected = correction.apply(source.predictor(bare.name).predict, inputs)
    differences = np.abs(found.astype(np.float64) - expected)
    largest = float(differences.max())
    if not largest <= TOLERANCE:
        row, column = np.unravel_index(int(np.argmax(np.nan_to_num(differences, nan=np.inf))), found.shape)
        raise ArtifactError(
            f"parity: window {row}, channel {CHANNELS[column]}: the artifact gives {found[row, column]}, "
            f"base and effects {expected[row, column]}: expected at most {TOLERANCE:g} counts between them"
        )
    return Parity(windows=len(inputs), largest_difference=largest, tolerance=TOLERANCE)


def _write_bare(repository: Path, base: Artifact) -> Manifest:
    """The model file without any effect, as an artifact of its own."""
    layout = WindowLayout.of(base.manifest.spec.unshifted, base.manifest.window.model_extras)
    manifest = _with_window(base.manifest, layout, {"effects": ()})
    folder = repository / manifest.name / manifest.version
    folder.mkdir(parents=True)
    (folder / manifest.model_file.name).write_bytes(base.model_path.read_bytes())
    (folder / artifacts.MANIFEST).write_text(manifest_json(manifest), encoding="utf-8")
    return manifest
