"""Artifacts on disk: `<repository>/<name>/<version>/{model file, manifest.json, README.md}`."""

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter, ValidationError

from taxel.errors import ArtifactError, NotFound
from taxel.manifest import Manifest, Name, Version

MANIFEST: Final = "manifest.json"

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
    """Read and check one artifact: its manifest, its place, and its model file's hash.

    Raises:
        ArtifactError: anything is missing, damaged or inconsistent; the text says what.
    """
    path = folder / MANIFEST
    try:
        text = path.read_bytes()
    except OSError as error:
        raise ArtifactError(f"{path}: {error.strerror or error}") from None
    try:
        manifest = Manifest.model_validate_json(text)
    except ValidationError as error:
        raise ArtifactError(f"{path}: {describe(error)}") from None
    if (manifest.name, manifest.version) != (folder.parent.name, folder.name):
        place = f"{folder.parent.name}/{folder.name}"
        raise ArtifactError(f"{path} is of {manifest.name}/{manifest.version}, but lies in {place}")
    model_path = folder / manifest.model_file.name
    try:
        found = fingerprint(model_path)
    except OSError as error:
        raise ArtifactError(f"{model_path}: {error.strerror or error}") from None
    if found != manifest.model_file.sha256:
        raise ArtifactError(
            f"{model_path}: sha256 {found[:12]}…, but its manifest says "
            f"{manifest.model_file.sha256[:12]}…: the file is damaged or was replaced"
        )
    return Artifact(manifest, model_path)


def fingerprint(path: Path) -> str:
    """The sha256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
