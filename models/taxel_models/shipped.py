"""The repository of shipped artifacts: in the wheel, or in the checkout."""

from pathlib import Path

from taxel.errors import ArtifactError


def shipped_repository() -> Path:
    """The repository of shipped artifacts.

    Raises:
        ArtifactError: this installation has none.
    """
    here = Path(__file__).resolve().parent
    for place in (here / "repository", here.parent / "repository"):
        if place.is_dir():
            return place
    raise ArtifactError(f"no shipped models beside {here}: the installation is incomplete")
