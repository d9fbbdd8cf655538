"""Publishes an artifact: builds it in a temporary folder, checks it, and moves it into the repository."""

import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from taxel import artifacts
from taxel.artifacts import MANIFEST, manifest_json
from taxel.errors import ArtifactError, NotFound, SettingsError
from taxel.manifest import Manifest
from taxel_exporters.card import card

CARD: Final = "README.md"

Check = Callable[[Path], Mapping[str, Any]]
"""Checks the artifact in a staging repository, and gives fields of the manifest that say what it found;
raises `ArtifactError` if it is not right."""


def publish(repository: Path, manifest: Manifest, content: bytes, check: Check) -> Manifest:
    """Add an artifact to a repository, whole and checked, or add nothing.

    Args:
        content: content of the model file.
        check: compares the staged artifact with what it was made from.

    Returns:
        The manifest as written, with what `check` found.

    Raises:
        ArtifactError: the artifact is not right.
        SettingsError: this name and version are not possible, or exist.
    """
    place = _free_place(repository, manifest.name, manifest.version)
    repository.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=".export.", dir=repository))
    try:
        staged = staging / manifest.name / manifest.version
        staged.mkdir(parents=True)
        (staged / manifest.model_file.name).write_bytes(content)
        (staged / MANIFEST).write_text(manifest_json(manifest), encoding="utf-8")
        manifest = manifest.model_copy(update=check(staging))
        (staged / MANIFEST).write_text(manifest_json(manifest), encoding="utf-8")
        (staged / CARD).write_text(card(manifest), encoding="utf-8")
        artifacts.read(staged)
        place.parent.mkdir(exist_ok=True)
        staged.rename(place)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return manifest


def free_version(repository: Path, name: str, version: str | None) -> str:
    """The version to publish: the one asked for, or the next.

    Raises:
        SettingsError: this name and version are not possible, or exist.
    """
    version = version or _next_version(repository, name)
    _free_place(repository, name, version)
    return version


def _next_version(repository: Path, name: str) -> str:
    try:
        return str(int(artifacts.versions(repository, name)[-1]) + 1)
    except (ArtifactError, NotFound, IndexError):
        return "1"


def _free_place(repository: Path, name: str, version: str) -> Path:
    if not artifacts.is_name(name):
        raise SettingsError(f"--name {name!r}: expected letters, digits, '.', '_' or '-', at most 64")
    if not artifacts.is_version(version):
        raise SettingsError(f"--version {version!r}: expected a positive whole number")
    place = repository / name / version
    if place.exists():
        raise SettingsError(f"{place} exists already: versions do not change; choose another")
    return place
