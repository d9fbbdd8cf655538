"""Artifacts on disk: `<repository>/<name>/<version>/{model file, manifest.json, README.md}`."""

import hashlib
import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter, ValidationError

from taxel.contained import open_contained
from taxel.errors import ArtifactError, NotFound
from taxel.manifest import Manifest, ModelFile, Name, Version

MANIFEST: Final = "manifest.json"

MOST_MANIFEST_BYTES: Final = 4 * 2**20
MOST_MODEL_BYTES: Final = 2**30
"""The largest files that are read. Shipped manifests have 12 kB, shipped model files 5 MB."""

_NAME: Final = TypeAdapter[str](Name)
_VERSION: Final = TypeAdapter[str](Version)


@dataclass(frozen=True)
class Artifact:
    """One checked artifact: its manifest and where its model file lies."""

    manifest: Manifest
    model_path: Path

    @property
    def base(self) -> "Artifact":
        """The same model file without the effects that correct it."""
        return replace(self, manifest=self.manifest.base)


def names(repository: Path) -> list[str]:
    """Models in a repository, sorted; folders whose name could not be a model's are skipped.

    Raises:
        ArtifactError: the repository is no folder.
    """
    if not repository.is_dir():
        raise ArtifactError(f"{repository}: no such folder; expected a repository of models")
    return sorted(path.name for path in repository.iterdir() if path.is_dir() and is_name(path.name))


def versions(repository: Path, name: str) -> list[str]:
    """Versions of a model, oldest first.

    Raises:
        NotFound: the repository has no such model.
    """
    folder = repository / name
    if not is_name(name) or not folder.is_dir():
        known = ", ".join(names(repository)) or "none"
        raise NotFound(f"no model {name!r} in {repository}; it has: {known}")
    return sorted((path.name for path in folder.iterdir() if is_version(path.name)), key=int)


def folder_of(repository: Path, name: str, version: str | None = None) -> Path:
    """The folder of one version of a model, the newest if none is named.

    Raises:
        NotFound: there is no such model or version.
    """
    known = versions(repository, name)
    if version is None:
        if not known:
            raise NotFound(f"model {name!r} in {repository} has no version")
        version = known[-1]
    if version not in known:
        raise NotFound(f"model {name!r} has no version {version!r}; it has: {', '.join(known) or 'none'}")
    return repository / name / version


def is_name(text: str) -> bool:
    """Whether a model may be called so: letters, digits, '.', '_' and '-', at most 64."""
    return _accepts(_NAME, text)


def is_version(text: str) -> bool:
    """Whether this is a version: a positive whole number."""
    return _accepts(_VERSION, text)


def _accepts(adapter: TypeAdapter[str], text: str) -> bool:
    try:
        adapter.validate_python(text)
    except ValidationError:
        return False
    return True


def read(folder: Path) -> Artifact:
    """Read and check one artifact: its manifest, its place, and its model file's size and hash.

    Each file is ordinary and of a bounded size, and no link leads out of the repository: this is checked
    before a byte is read.

    Raises:
        ArtifactError: anything is missing, damaged or inconsistent; the text says what.
    """
    repository = folder.parent.parent
    path = folder / MANIFEST
    try:
        with open_contained(path, inside=repository, most_bytes=MOST_MANIFEST_BYTES) as file:
            text = file.read(MOST_MANIFEST_BYTES)
        manifest = Manifest.model_validate_json(text)
    except OSError as error:
        raise ArtifactError(f"{path}: {error.strerror or error}") from None
    except ValidationError as error:
        raise ArtifactError(f"{path}: {describe(error)}") from None
    if (manifest.name, manifest.version) != (folder.parent.name, folder.name):
        place = f"{folder.parent.name}/{folder.name}"
        raise ArtifactError(f"{path} is of {manifest.label}, but lies in {place}")
    model_path = folder / manifest.model_file.name
    _check_model_file(model_path, manifest.model_file, repository)
    return Artifact(manifest, model_path)


def _check_model_file(path: Path, expected: ModelFile, repository: Path) -> None:
    """Raise if a file is not the one that its manifest describes."""
    try:
        with open_contained(path, inside=repository, most_bytes=MOST_MODEL_BYTES) as file:
            size = os.fstat(file.fileno()).st_size
            if size != expected.size:
                raise ArtifactError(
                    f"{path}: {size} bytes, but its manifest says {expected.size}: "
                    "the file is damaged or was replaced"
                )
            found = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ArtifactError(f"{path}: {error.strerror or error}") from None
    if found != expected.sha256:
        raise ArtifactError(
            f"{path}: sha256 {found[:12]}…, but its manifest says "
            f"{expected.sha256[:12]}…: the file is damaged or was replaced"
        )


def describe(error: ValidationError) -> str:
    """A validation error in one line: each fault with the field it is in."""
    faults = [
        ".".join(str(part) for part in fault["loc"])
        + (": " if fault["loc"] else "")
        + fault["msg"].removeprefix("Value error, ")
        for fault in error.errors(include_url=False, include_input=False)
    ]
    return "; ".join(faults)


def manifest_json(manifest: Manifest) -> str:
    """The text of `manifest.json`: stable, so that equal manifests are equal files."""
    return json.dumps(manifest.model_dump(mode="json"), indent=1, ensure_ascii=False) + "\n"
