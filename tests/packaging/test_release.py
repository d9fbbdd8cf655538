"""`make release`, in a clone of this checkout."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "packaging" / "release.py"
PERSON = {f"GIT_{who}_{what}": "tester" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}


def git(clone: Path, *arguments: str) -> str:
    done = subprocess.run(
        ["git", *arguments], cwd=clone, capture_output=True, text=True, check=True, env=os.environ | PERSON
    )
    return done.stdout.strip()


def release(clone: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), *arguments]
    return subprocess.run(command, cwd=clone, capture_output=True, text=True, env=os.environ | PERSON)


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone with something to release, whatever state this checkout's changelog is in."""
    if not (ROOT / ".git").exists():
        pytest.skip("a release is made from a git checkout")
    git(ROOT, "clone", "-q", "--no-tags", str(ROOT), str(tmp_path / "clone"))
    clone = tmp_path / "clone"
    changelog = clone / "CHANGELOG.md"
    text = changelog.read_text().replace("## Unreleased\n", "## Unreleased\n\n### Fixed\n\n- A fault.\n", 1)
    changelog.write_text(text)
    git(clone, "commit", "-qam", "Something to release")
    return clone


def test_a_release_is_bumped_dated_built_committed_and_tagged(clone: Path) -> None:
    done = release(clone, "99.0.0")
    assert done.returncode == 0, done.stderr
    assert "To publish: git push --follow-tags, and twine upload dist/*99.0.0*" in done.stdout
    assert git(clone, "status", "--porcelain") == ""
    assert git(clone, "log", "-1", "--format=%s") == "Release 99.0.0"
    assert git(clone, "rev-parse", "v99.0.0^{commit}") == git(clone, "rev-parse", "HEAD")
    assert '__version__: Final = "99.0.0"' in (clone / "clients/python/taxel/__init__.py").read_text()
    assert "## Unreleased\n\n## 99.0.0 - 20" in (clone / "CHANGELOG.md").read_text()
    assert "\nversion: 99.0.0\ndate-released: " in (clone / "CITATION.cff").read_text()
    names = {path.name for path in (clone / "dist").iterdir()}
    assert names == {"taxel-99.0.0.tar.gz", "taxel-99.0.0-py3-none-any.whl"}
    assert all(path.stat().st_size < 12_000_000 for path in (clone / "dist").iterdir())
    again = release(clone, "99.0.1")
    assert again.returncode == 1
    assert "expected entries below '## Unreleased'" in again.stderr


def test_a_dry_run_changes_nothing(clone: Path) -> None:
    before = git(clone, "rev-parse", "HEAD")
    done = release(clone, "99.0.0", "--dry")
    assert done.returncode == 0, done.stderr
    assert "git push" not in done.stdout
    assert '+__version__: Final = "99.0.0"' in done.stdout
    assert (git(clone, "rev-parse", "HEAD"), git(clone, "tag"), git(clone, "status", "--porcelain")) == (
        *(before, ""),
        "",
    )
    assert not (clone / "dist").exists()


def test_what_cannot_be_released_is_refused_and_left_as_it_is(clone: Path) -> None:
    for version in ("0.0.1", "1.0", "next"):
        assert f"version {version}: expected X.Y.Z, above" in release(clone, version).stderr
    git(clone, "tag", "v98.0.0")
    assert "there is a tag v98.0.0 already" in release(clone, "98.0.0").stderr
    assert git(clone, "status", "--porcelain") == ""
    (clone / "README.md").write_text("changed")
    refused = release(clone, "99.0.0")
    assert refused.returncode == 1
    assert "expected a clean working tree" in refused.stderr
    outside = release(clone.parent, "99.0.0")
    assert outside.returncode == 1
    assert outside.stderr.startswith("release: git rev-parse:")
    assert (clone / "README.md").read_text() == "changed"
    assert not (clone / "dist").exists()


def test_a_failed_build_says_how_to_undo_the_edits(clone: Path) -> None:
    (clone / "pyproject.toml").write_text("[build-system]\n")
    git(clone, "commit", "-qam", "A project that cannot be built")
    refused = release(clone, "99.0.0")
    assert refused.returncode == 1
    assert "git checkout -- clients/python/taxel/__init__.py CHANGELOG.md CITATION.cff" in refused.stderr
    assert git(clone, "tag") == ""
    assert git(clone, "log", "-1", "--format=%s") == "A project that cannot be built"
