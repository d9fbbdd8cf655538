"""The documentation site: what it is made from."""

import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Final

import pytest

ROOT: Final = Path(__file__).resolve().parents[2]
SITE: Final = ROOT / "packaging" / "site"


def _module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SITE / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def pages(tmp_path: Path) -> Iterator[Path]:
    if not (ROOT / ".git").exists():
        pytest.skip("a source archive has no list of its files")
    _module("sources").gather(ROOT, tmp_path)
    return tmp_path


def test_pages_and_what_they_link_to_are_gathered(pages: Path) -> None:
    assert (pages / "index.md").read_text().startswith("# Taxel")
    assert (pages / "docs" / "wire" / "lane_request.bin").read_bytes() == (
        ROOT / "docs" / "wire" / "lane_request.bin"
    ).read_bytes()
    assert "](#)" not in (pages / "index.md").read_text()
    # The moving picture is written in HTML, for its width.
    assert '<img src="docs/watch.gif"' in (pages / "index.md").read_text()
    assert (pages / "docs" / "watch.gif").exists()


def test_every_page_is_in_the_table_of_contents_or_linked(pages: Path) -> None:
    """A page that nothing leads to is a page that nobody finds."""
    contents = (ROOT / "zensical.toml").read_text()
    texts = {page: page.read_text() for page in pages.rglob("*.md")}
    for page in texts:
        name = str(page.relative_to(pages))
        linked = any(f"{page.name}" in text for other, text in texts.items() if other != page)
        assert name in contents or linked, name


def test_the_reference_names_every_command_option_and_error(tmp_path: Path) -> None:
    from importlib.metadata import entry_points

    import taxel.errors
    from taxel_server.options import ServerOptions

    _module("reference").write_reference(tmp_path / "reference")
    folder = tmp_path / "reference" / "commands"
    commands = {page.stem for page in folder.glob("*.md")} - {"README"}
    below = {name for name in commands if name.startswith("bench-")}
    assert commands - below == {entry.name for entry in entry_points(group="taxel.commands")}
    assert below == set(re.findall(r"\]\((.+)\.md\):", (folder / "bench.md").read_text()))
    assert (folder / "bench-run.md").read_text().startswith("# `taxel bench run`\n")
    options = (tmp_path / "reference" / "options.md").read_text()
    assert all(f"`{name}`" in options for name in ServerOptions.model_fields)
    errors = (tmp_path / "reference" / "errors.md").read_text()
    for error in (taxel.errors.ServerLost, taxel.errors.RecordingError, taxel.errors.TaxelError):
        assert f"## {error.__name__}\n" in errors


def test_every_error_that_can_be_met_has_a_cure(tmp_path: Path) -> None:
    _module("reference").write_reference(tmp_path / "reference")
    _, *sections = (tmp_path / "reference" / "errors.md").read_text().split("\n## ")
    without = [section.splitlines()[0] for section in sections if "\nCure: " not in section]
    assert without == ["TaxelError", "RequestError"]
    assert len(sections) > 12
    assert not any("Args:" in section for section in sections)


def test_each_page_that_llms_txt_names_is_on_the_site(pages: Path, tmp_path: Path) -> None:
    """Programs read Markdown; only what is written from code stays HTML, which the build makes."""
    (pages / "code.md").write_text("# Code\n\n::: taxel\n")
    _module("llms").write_llms(pages, site := tmp_path / "site")
    told = re.findall(r"\]\((.+)\)", (site / "llms.txt").read_text())
    assert len(told) > 100
    assert [one for one in told if not (site / one).exists()] == ["code.html"]
    assert (site / "docs" / "start.md").read_text() == (pages / "docs" / "start.md").read_text()


def test_no_page_is_longer_than_a_short_read(pages: Path) -> None:
    """At most 1,200 words, outside the results and the list of changes."""
    _module("reference").write_reference(pages / "docs" / "reference")
    found = {page.relative_to(pages): len(page.read_text().split()) for page in pages.rglob("*.md")}
    assert len(found) > 100
    long = {page.as_posix() for page, words in found.items() if words > 1200}
    assert {page for page in long if not page.startswith("docs/results/")} == {"CHANGELOG.md"}


def test_every_link_of_the_documents_leads_somewhere() -> None:
    if not (ROOT / "docs" / "results").is_dir():
        pytest.skip("a source archive leaves the results out")
    documents = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *ROOT.glob("*/README.md")]
    for document in documents:
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", document.read_text()):
            assert (document.parent / target).exists(), f"{document}: {target}"
