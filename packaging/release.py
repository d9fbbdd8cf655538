"""`make release VERSION=x.y.z`: bump, date the changelog, build, check, commit, tag. Publishes nothing.

With `--dry`, all of that happens in a temporary clone, which is shown and deleted.
"""

import argparse
import datetime
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

VERSION = Path("clients/python/taxel/__init__.py")
CHANGELOG = Path("CHANGELOG.md")
CITATION = Path("CITATION.cff")

_RELEASE = re.compile(r"\d+\.\d+\.\d+")
_UNRELEASED = "## Unreleased\n"


class Refused(Exception):
    """The release cannot be made; the text says why."""


def main() -> int:
    """The exit status: 0 where the release was made."""
    parser = argparse.ArgumentParser(prog="make release", description=__doc__.splitlines()[0])
    parser.add_argument("version", help="The new version, as 1.2.3.")
    parser.add_argument("--dry", action="store_true", help="In a temporary clone, which is deleted.")
    options = parser.parse_args()
    try:
        root = Path(_git(Path.cwd(), "rev-parse", "--show-toplevel"))
        if not options.dry:
            release(root, options.version)
            files = f"dist/*{options.version}*"
            print(f"To publish: git push --follow-tags, and twine upload {files}")
            return 0
        with TemporaryDirectory(prefix="taxel-release-") as folder:
            _check_clean(root)
            clone = Path(folder) / "clone"
            _git(root, "clone", "-q", root, clone)
            release(clone, options.version)
            print(_git(clone, "show", "--stat", "--patch", tag_of(options.version)))
        print("A dry run: nothing was changed here.")
    except Refused as refusal:
        print(f"release: {refusal}", file=sys.stderr)
        return 1
    return 0


def release(root: Path, version: str) -> None:
    """Make a release in a clean checkout: its files in `dist/`, a commit and a tag.

    The files are built and checked before the commit. If that fails, the edits stay in the working tree.

    Raises:
        Refused: the version, the tree, the changelog or what was built is not as it should be.
    """
    _check_clean(root)
    tag = tag_of(version)
    if _git(root, "tag", "--list", tag):
        raise Refused(f"there is a tag {tag} already")
    edited = _edited(root, version, datetime.datetime.now(datetime.UTC).date().isoformat())
    for path, text in edited.items():
        (root / path).write_text(text, encoding="utf-8")
    try:
        files = _built(root, version)
    except Refused as refusal:
        names = " ".join(map(str, edited))
        raise Refused(
            f"{refusal}\nNothing was committed. The edits are in the working tree; to undo them: "
            f"git checkout -- {names}"
        ) from None
    _git(root, "commit", "-q", "-m", f"Release {version}", "--", *edited)
    _git(root, "tag", "-a", tag, "-m", f"Taxel {version}")
    for path in files:
        print(f"{path.relative_to(root)}  {path.stat().st_size / 1e6:.1f} MB")
    print(f"Committed and tagged {tag}.")


def tag_of(version: str) -> str:
    """The tag of a version."""
    return f"v{version}"


def _check_clean(root: Path) -> None:
    changed = _git(root, "status", "--porcelain")
    if changed:
        raise Refused(f"expected a clean working tree; there is:\n{changed}")


def _edited(root: Path, version: str, date: str) -> dict[Path, str]:
    """The text of each file that a release changes."""
    source = (root / VERSION).read_text(encoding="utf-8")
    found = re.search(r'__version__: Final = "([^"]+)"', source)
    if found is None:
        raise Refused(f"{VERSION}: expected a line __version__: Final = …")
    if not _RELEASE.fullmatch(version) or _numbers(version) <= _numbers(found[1]):
        raise Refused(f"version {version}: expected X.Y.Z, above {found[1]}")
    changelog = (root / CHANGELOG).read_text(encoding="utf-8")
    _, heading, rest = changelog.partition(_UNRELEASED)
    if not heading or not rest.partition("\n## ")[0].strip():
        raise Refused(f"{CHANGELOG}: expected entries below '{_UNRELEASED.strip()}'")
    citation = (root / CITATION).read_text(encoding="utf-8")
    lines = f'version: {version}\ndate-released: "{date}"\n'
    citation, versions = re.subn(
        r"^version: .*\n(date-released: .*\n)?", lines, citation, flags=re.MULTILINE
    )
    if versions != 1:
        raise Refused(f"{CITATION}: expected one line 'version:'")
    return {
        VERSION: source.replace(found[0], f'__version__: Final = "{version}"'),
        CHANGELOG: changelog.replace(_UNRELEASED, f"{_UNRELEASED}\n## {version} - {date}\n", 1),
        CITATION: citation,
    }


def _numbers(version: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", version)]


def _built(root: Path, version: str) -> list[Path]:
    """The source archive and the wheel in `dist/`, checked as a package index would."""
    names = (f"taxel-{version}.tar.gz", f"taxel-{version}-py3-none-any.whl")
    files = [root / "dist" / name for name in names]
    _run(root, "build", "--no-isolation", "--outdir", "dist")
    missing = [path.name for path in files if not path.exists()]
    if missing:
        raise Refused(f"the build wrote no {', '.join(missing)}")
    _run(root, "twine", "check", "--strict", *files)
    return files


def _run(root: Path, module: str, *arguments: str | Path) -> None:
    command = [sys.executable, "-m", module, *map(str, arguments)]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True)
    if done.returncode != 0:
        raise Refused(f"{module} failed:\n{done.stdout}{done.stderr}")


def _git(root: Path, *arguments: str | Path) -> str:
    done = subprocess.run(["git", *map(str, arguments)], cwd=root, capture_output=True, text=True)
    if done.returncode != 0:
        raise Refused(f"git {arguments[0]}: {done.stderr.strip()}")
    return done.stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
