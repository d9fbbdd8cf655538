"""What made each picture and result of the documents, and whether it is older than what it is made from.

python packaging/site/figures.py            says what is stale
python packaging/site/figures.py PATH …     stamps these, once their commands have made them again

`docs/figures.json` has an entry for each: `files`, `command`, and the `version` of Taxel that made it.
The code or the data that a picture is drawn from are its `sources`, each with a digest. What a test makes
again has that test as `remade_by`. What has neither was measured: it is dated by its version, and no later
change of the code makes it stale.
"""

import json
import sys
from collections.abc import Iterator
from fnmatch import fnmatchcase
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[2]
LISTED: Final = "docs/figures.json"

_DIGITS: Final = 16

Figure = dict[str, Any]


def figures(root: Path) -> list[Figure]:
    """The entries of `docs/figures.json`."""
    listed: list[Figure] = json.loads((root / LISTED).read_text())
    return listed


def kept(root: Path) -> list[str]:
    """Paths of all that the documents keep and nobody wrote by hand."""
    by_hand = {"README.md", "benchmark.md", "benchmark_avx512.md", "recovery.md", "study.md", "trees.md"}
    found = [
        path
        for path in (root / "docs").rglob("*")
        if path.is_file()
        and (
            path.suffix != ".md"
            if "results" not in path.relative_to(root / "docs").parts
            else path.name not in by_hand
        )
    ]
    return sorted(name for path in found if (name := path.relative_to(root).as_posix()) != LISTED)


def has(figure: Figure, path: str) -> bool:
    """Whether an entry is about a file."""
    return any(fnmatchcase(path, pattern) for pattern in figure["files"])


def problems(root: Path) -> Iterator[str]:
    """A sentence for each file without an entry, each entry without a file, and each that is stale."""
    listed, paths = figures(root), kept(root)
    for path in paths:
        if (entries := sum(has(figure, path) for figure in listed)) != 1:
            yield f"{path} has {entries} entries in {LISTED}: expected one"
    for figure in listed:
        for pattern in figure["files"]:
            if not any(fnmatchcase(path, pattern) for path in paths):
                yield f"{pattern} in {LISTED} is no file"
        for source, stamped in figure.get("sources", {}).items():
            if not (root / source).exists():
                yield f"{figure['files'][0]} is made from {source}, which is not there"
            elif digest(root / source) != stamped:
                yield (
                    f"{figure['files'][0]} is older than {source}. Make it again: {figure['command']}. "
                    f"Then stamp it: python packaging/site/figures.py {figure['files'][0]}"
                )


def digest(source: Path) -> str:
    """Of a file's bytes, or of the names and bytes of all files in a folder."""
    files = sorted(path for path in source.rglob("*") if path.is_file()) if source.is_dir() else [source]
    taken = sha256()
    for path in files:
        if "__pycache__" not in path.parts:
            taken.update(path.relative_to(source).as_posix().encode() + b"\0" + path.read_bytes())
    return taken.hexdigest()[:_DIGITS]


def stamp(root: Path, path: str) -> None:
    """Write today's version and digests into the entry of a file.

    Raises:
        SystemExit: there is no such entry.
    """
    from taxel import __version__

    listed = figures(root)
    found = [figure for figure in listed if has(figure, path) or path in figure["files"]]
    if not found:
        raise SystemExit(f"{path}: expected a file of {LISTED}")
    for figure in found:
        figure["version"] = __version__
        for source in figure.get("sources", {}):
            figure["sources"][source] = digest(root / source)
    (root / LISTED).write_text(json.dumps(listed, indent=1, ensure_ascii=False) + "\n")


def main(paths: list[str]) -> int:
    """The exit status: 0 where nothing is stale."""
    for path in paths:
        stamp(ROOT, path)
    found = list(problems(ROOT))
    print("\n".join(found) or "Every figure is listed, and none is older than what it is made from.")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
