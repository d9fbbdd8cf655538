"""Export of a correction: the same model file with effects, as a new version beside the old."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

import taxel
from taxel import artifacts
from taxel.artifacts import Artifact
from taxel.corrections import AppliedEffect, Composition
from taxel.errors import ArtifactError, InvalidArgument
from taxel.manifest import Manifest, Parity, WindowLayout
from taxel.windows import ExtraFeature, WindowSpec
from taxel_exporters.agreement import agreement
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
        extras: that the effects take, `taken_by` the effects. One that the version has already, for
            its model file or former effects, is not repeated, and keeps its default.
        windows: to check the served artifact on; (n, f), n above 0, as the old version takes
            them, then `extras`; or without the last ones, which then take their defaults.
        description: the old one's if none is given.

    Raises:
        ArtifactError: the old version is damaged, the new one is inconsistent, or what is served
            differs from base prediction and effects computed offline.
        InvalidArgument: the windows are not such.
        NotFound: there is no such model or version.
    """
    base = artifacts.read(artifacts.folder_of(repository, name, version))
    new = _new_extras(base.manifest, extras)
    manifest = _corrected(base.manifest, free_version(repository, name, None), effects, new, description)
    first = len(base.manifest.window.features)
    repeated = [first + place for place, extra in enumerate(extras) if extra not in new]
    taken = np.delete(windows, [column for column in repeated if column < windows.shape[1]], axis=1)
    return publish(
        repository,
        manifest,
        base.model_path.read_bytes(),
        lambda staging: {"parity": _check_parity(staging, manifest, base, taken)},
    )


def _new_extras(base: Manifest, extras: Sequence[ExtraFeature]) -> tuple[ExtraFeature, ...]:
    """Those that the old version does not have, by their names."""
    known = {extra.name: extra for extra in base.window.extras}
    for extra in extras:
        if extra.name in known and known[extra.name].history != extra.history:
            raise ArtifactError(
                f"extra {extra.name!r} is another feature in {base.label}: expected another name"
            )
    return tuple(extra for extra in extras if extra.name not in known)


def _corrected(
    base: Manifest,
    version: str,
    effects: Sequence[AppliedEffect],
    new: tuple[ExtraFeature, ...],
    description: str | None,
) -> Manifest:
    everything = (*base.effects, *effects)
    shift = sum(effect.shift_ticks for effect in everything)
    changes = {
        "version": version,
        "description": description or base.description,
        "effects": everything,
        "parity": None,
        "taxel_version": taxel.__version__,
    }
    try:
        layout = WindowLayout.of(WindowSpec.of(base.window.combination, shift), base.window.extras + new)
        return base.with_window(layout, **changes)
    except (InvalidArgument, ValidationError) as error:
        reason = artifacts.describe(error) if isinstance(error, ValidationError) else str(error)
        raise ArtifactError(f"{base.label} cannot be corrected so: {reason}") from None


def _check_parity(
    staging: Path, manifest: Manifest, base: Artifact, windows: NDArray[np.float32]
) -> Parity:
    """Compare what is served with the model file's own prediction and the effects, added offline.

    The model file is loaded alone, and the effects are added without the code that serves them: only
    the frames' and the terms' own equations are the same.
    """
    with taxel.load(staging) as source:
        served = source.predictor(manifest.name)
        inputs = served.checked(windows)
        found = served.predict(inputs)
    names = [*manifest.spec.unshifted.features, *(extra.name for extra in manifest.window.extras)]
    columns = {name: inputs[:, column].astype(np.float64) for column, name in enumerate(names)}
    turned = inputs[:, : manifest.window.model_columns]
    for effect in reversed(manifest.effects):
        turned = effect.frame.turn(turned, manifest.spec) if effect.frame else turned
    with tempfile.TemporaryDirectory() as folder:
        _write(Path(folder), base.base)
        with taxel.load(folder) as source:
            p = source.predictor(base.manifest.name).predict(turned)
    terms = Composition(term for effect in manifest.effects for term in effect.terms)
    expected = terms.counts(p.astype(np.float64), columns)
    return agreement(found, expected, TOLERANCE, "base and effects")


def _write(repository: Path, artifact: Artifact) -> None:
    """An artifact in a repository of its own."""
    manifest = artifact.manifest
    folder = repository / manifest.name / manifest.version
    folder.mkdir(parents=True)
    (folder / manifest.model_file.name).write_bytes(artifact.model_path.read_bytes())
    (folder / artifacts.MANIFEST).write_text(artifacts.manifest_json(manifest), encoding="utf-8")
