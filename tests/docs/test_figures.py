"""Pictures and results that the documents keep: what made them, and that none is stale."""

import importlib
import importlib.util
import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import matplotlib as mpl
import pytest

from taxel.windows import ExtraFeature
from taxel.windows.history import Relaxation
from taxel_bench.choice.files import markdown as choice_table
from taxel_bench.choice.measurement import ComparedModel
from taxel_models.commands.frame import frame
from taxel_models.loop.findings import Findings
from taxel_models.loop.report.contents import EFFECT, Told, contents
from taxel_models.loop.report.document import Picture
from taxel_models.loop.report.rendering import markdown

ROOT: Final = Path(__file__).resolve().parents[2]
SITE: Final = ROOT / "packaging" / "site"


def _module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SITE / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FIGURES: Final = _module("figures")

with_results: Final = pytest.mark.skipif(
    not (ROOT / "docs" / "results").is_dir(), reason="a source archive leaves the results out"
)


@with_results
def test_every_figure_is_listed_and_none_is_stale() -> None:
    assert list(FIGURES.problems(ROOT)) == []


@with_results
def test_an_entry_tells_the_version_that_the_file_itself_tells() -> None:
    for figure in FIGURES.figures(ROOT):
        for path in FIGURES.kept(ROOT):
            if FIGURES.has(figure, path) and path.endswith(".json"):
                told = _told(json.loads((ROOT / path).read_text()))
                assert told in (None, figure["version"]), path


def _told(result: dict[str, Any]) -> str | None:
    versions = result.get("machine", {}).get("versions", {})
    told: str | None = versions.get("taxel", result.get("taxel_version"))
    return told


def test_an_entry_names_a_version_of_the_changelog_and_what_else_is_there() -> None:
    versions = re.findall(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    for figure in FIGURES.figures(ROOT):
        assert figure["version"] in versions, figure["files"]
        named = [figure[key] for key in ("remade_by", "page") if key in figure]
        assert all((ROOT / one).exists() or one.startswith("docs/results/") for one in named)


def test_what_is_older_than_its_source_is_named_with_the_command_that_makes_it(tmp_path: Path) -> None:
    (tmp_path / "docs" / "results").mkdir(parents=True)
    for name in ("docs/skin.png", "docs/results/run.json", "docs/results/README.md", "skin.py"):
        (tmp_path / name).write_text("before")
    entry = {"command": "taxel skin", "version": "0.1.0"}
    skin = {"files": ["docs/skin.png"], **entry, "sources": {"skin.py": ""}}
    (tmp_path / FIGURES.LISTED).write_text(json.dumps([skin, {"files": ["docs/old.png"], **entry}]))
    FIGURES.stamp(tmp_path, "docs/skin.png")
    assert list(FIGURES.problems(tmp_path)) == [
        "docs/results/run.json has 0 entries in docs/figures.json: expected one",
        "docs/old.png in docs/figures.json is no file",
    ]
    (tmp_path / "skin.py").write_text("after")
    assert list(FIGURES.problems(tmp_path))[1] == (
        "docs/skin.png is older than skin.py. Make it again: taxel skin. "
        "Then stamp it: python packaging/site/figures.py docs/skin.png"
    )
    with pytest.raises(SystemExit, match=r"docs/new\.png: expected a file of docs/figures\.json"):
        FIGURES.stamp(tmp_path, "docs/new.png")


def test_the_drawings_show_what_the_code_says(tmp_path: Path) -> None:
    """Drawn again by the same matplotlib they are the same files, and by another one they say the same."""
    drawings = _module("drawings")
    drawings.draw(tmp_path)
    frame(tmp_path / "frame.svg")
    for name in (*drawings.DRAWINGS, "frame.svg"):
        shown, now = (folder.joinpath(name).read_text() for folder in (ROOT / "docs", tmp_path))
        if f"Matplotlib v{mpl.__version__}," not in shown:
            shown, now = ("\n".join(re.findall(r"<text[^>]*>([^<]*)<", one)) for one in (shown, now))
        (command,) = (one["command"] for one in FIGURES.figures(ROOT) if f"docs/{name}" in one["files"])
        assert shown == now, f"docs/{name} is not of today: {command}"


@with_results
def test_a_report_that_is_kept_as_an_example_has_the_form_of_today() -> None:
    found = [figure for figure in FIGURES.figures(ROOT) if "form" in figure]
    assert found
    for figure in found:
        module, name = figure["form"].split(":")
        form = getattr(importlib.import_module(module), name)
        for path in figure["files"]:
            kept = json.loads((ROOT / path).read_text())
            today = form.model_validate(kept).model_dump(mode="json")
            assert kept == today, f"{path} has another form: {figure['command']}"


@with_results
def test_the_example_report_reads_as_today_s_code_would_write_it() -> None:
    """Its text is written again from its figures; its pictures, which need the recording, are kept."""
    folder = ROOT / "docs" / "results" / "loop_example"
    kept, findings = (folder / "report.md").read_text(), (folder / "report.json").read_text()
    told = Findings.model_validate_json(findings)
    drawn = {
        file: Picture(file, title, caption)
        for title, file, caption in re.findall(r"^!\[(.*)\]\((.*)\)\n\n(.*)$", kept, re.MULTILINE)
    }
    assert set(drawn) == {path.name for path in folder.glob("*.png")}
    keys = {f"effect-{at}-{one.name}.png": EFFECT + one.name for at, one in enumerate(told.effects, 1)}
    pictures = {keys.get(file, Path(file).stem): picture for file, picture in drawn.items()}
    # All that its effects need is of the past; which past, the text does not tell.
    past = Relaxation(of="force", time_constant_s=1.0)
    names = sorted({name for effect in told.effects for name in effect.needs})
    extras = [ExtraFeature(name=name, unit="N", history=past) for name in names]
    assert markdown(contents(Told(told, extras, pictures))) == kept, "make it again, as figures.json says"


@with_results
def test_the_page_of_models_has_the_measured_table() -> None:
    folder = ROOT / "docs" / "results" / "choice"
    models = json.loads((folder / "choice.json").read_text())["models"]
    table = choice_table([ComparedModel(**model) for model in models])
    assert (folder / "choice.md").read_text() == table
    assert table in (ROOT / "docs" / "which_model.md").read_text()


@with_results
def test_the_page_of_the_loop_tells_the_example_s_figures() -> None:
    page = (ROOT / "docs" / "loop.md").read_text()
    report = json.loads((ROOT / "docs" / "results" / "loop_example" / "report.json").read_text())
    split, before, after = (report[key] for key in ("split", "before", "after"))
    assert f"tested on {split['evaluation_blocks']} of {split['blocks']} blocks" in page
    assert f"falls from {before['norm_mae']:.3f} to {after['norm_mae']:.3f}." in page
    rows = re.findall(r"^\| (\w+),? ([^|]*?) \| ([\d.]+) % \|", page, re.MULTILINE)
    assert [name for name, *_ in rows] == [effect["name"] for effect in report["effects"]]
    for (_, form, share), effect in zip(rows, report["effects"], strict=True):
        assert f"{100 * effect['explained']:.2g}" == share
        assert not (times := re.findall(r"[\d.]+ s", effect["form"])) or times[0] in form
