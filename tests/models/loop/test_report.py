"""The folder that the loop's findings are written to."""

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from playwright.sync_api import sync_playwright

from taxel.channels import CHANNELS
from taxel.errors import SettingsError
from taxel_models.loop.attribution import Named
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining
from taxel_models.loop.effects.interference import Interference
from taxel_models.loop.effects.registry import NAMES, candidates
from taxel_models.loop.findings import Findings
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.contact_offset import ContactOffset
from taxel_models.loop.inference.forms import prepared
from taxel_models.loop.inference.whitening import Bins, NoiseShape, Whitening
from taxel_models.loop.pipeline import LoopResult, LoopSettings, run_loop
from taxel_models.loop.report import confounded_picture
from taxel_models.loop.report.confounded_picture import draw_confounded
from taxel_models.loop.report.contents import Told, contents
from taxel_models.loop.report.document import Picture, Table
from taxel_models.loop.report.drivers import axis_of
from taxel_models.loop.report.effect_pictures import draw_effect
from taxel_models.loop.report.error_pictures import parts_of
from taxel_models.loop.report.partial import Partial
from taxel_models.loop.report.rendering import markdown
from taxel_models.loop.report.report import REPORT, write_report
from taxel_models.model import Model
from taxel_models.recordings import Recording

ROWS = 7000
LOOKED_FOR = ("offset", "drift")
DRIFTING = slice(10, 14)
STUCK = CHANNELS.index("e18")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PNG = b"\x89PNG"
WATERFALL = Picture("waterfall.png", "explained shares", "Where the energy goes.")


@pytest.fixture(scope="module")
def result(smooth: Model, make: Callable[..., Recording]) -> LoopResult:
    """The loop on a model that lacks an offset in e1 to e6 and a drift in e9 to e12.

    e18 is stuck off and on, which is not looked for.
    """
    recording = make(ROWS)
    channels = recording.channels.copy()
    channels[:, 2:8] += 60
    channels[:, DRIFTING] += np.linspace(0, 150, ROWS)[:, None]
    channels[:, STUCK] = np.where(np.arange(ROWS) % 1000 < 300, 1500, channels[:, STUCK])
    others = tuple(name for name in NAMES if name not in LOOKED_FOR)
    settings = LoopSettings(exclude=(*others, "covariate:material"), stability=2)
    auxiliary = {**recording.auxiliary, "tdc": np.linspace(1900, 1990, ROWS)}
    recording = replace(recording, channels=channels, auxiliary=auxiliary)
    return run_loop(smooth, [recording], settings)


@pytest.fixture(scope="module")
def folder(result: LoopResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("loop") / "report"
    write_report(place, result)
    return place


class _Page(HTMLParser):
    """Which elements a page has, and whether each is result."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.sources: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_json_is_the_findings(folder: Path, result: LoopResult) -> None:
    assert Findings.model_validate_json((folder / REPORT).read_text("utf-8")) == result.findings


def test_markdown_shows_every_picture_and_effect(folder: Path, result: LoopResult) -> None:
    text = (folder / "report.md").read_text("utf-8")
    shown = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    assert {path.name for path in folder.glob("*.png")} == set(shown)
    assert all((folder / name).read_bytes().startswith(PNG) for name in shown)
    assert {effect.name for effect in result.findings.effects} == {"offset", "drift"}
    for effect in result.findings.effects:
        assert f"\n## {effect.name}\n" in text


def test_the_first_screen_is_a_sentence_what_changed_a_picture_and_a_table(result: LoopResult) -> None:
    changed = ("e7 lost 70 % of its sensitivity over this session.",)
    known = {**result.findings.split, "reference_rows": 9_000}
    findings = result.findings.model_copy(update={"changes": changed, "split": known})
    text = markdown(contents(Told(findings, result.new.extras, {"waterfall": WATERFALL})))
    first = [part for part in text.split("\n## ")[0].split("\n\n") if part]
    title, sentence, note, picture, _, table = first
    assert title == f"# What {findings.model} lacks"
    assert sentence.startswith(f"{findings.model} is off by a normalised MAE of")
    assert sentence.count(". ") == 0
    assert "offset and drift" in sentence or "drift and offset" in sentence
    assert note == f"> **{changed[0]}**"
    assert picture == "![explained shares](waterfall.png)"
    rows = table.strip().splitlines()
    assert [row.split(" | ")[0].strip("| ") for row in rows[2:]] == [one.name for one in findings.effects]
    assert all(" of 2 | " in row for row in rows[2:])


def test_many_parameters_fold_away_in_both_forms(folder: Path) -> None:
    text, page = ((folder / f"report.{kind}").read_text("utf-8") for kind in ("md", "html"))
    for written in (text, page):
        assert written.count("<details>") == written.count("</details>") == 1
        before, folded = written.split("<details>")
        folded, after = folded.split("</details>")
        for channel in ("e1", "e6", "e10"):
            assert f"offset {channel}" in folded
        assert "slope from 0 to 70 s" in after
        assert "offset e1 " not in before + after


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (on Debian: apt install chromium)")
def test_what_is_folded_on_the_screen_is_printed(folder: Path) -> None:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page()
        page.goto((folder / "report.html").as_uri())
        folded = page.locator("details table").first
        assert not folded.is_visible()
        page.emulate_media(media="print")
        assert folded.is_visible()
        # No table or picture is wider than the paper.
        page.set_viewport_size({"width": 680, "height": 960})
        assert page.evaluate("document.documentElement.scrollWidth") <= 680
        browser.close()


def test_diagnostics_are_for_programs_too(result: LoopResult) -> None:
    findings = result.findings
    assert findings.autocorrelation is not None
    assert set(findings.autocorrelation.before) == set(CHANNELS)
    inputs = {one.input for one in findings.cross_correlation}
    assert inputs == {"force", *(f"{what} {axis}" for what in ("force", "position") for axis in "xyz")}
    assert findings.stability is not None
    assert set(findings.stability.chosen) == {"offset", "drift"}
    assert findings.parameter_correlation is not None
    matrix = np.array(findings.parameter_correlation.matrix)
    assert matrix.shape == (len(findings.parameter_correlation.parameters),) * 2
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.abs(matrix).max() == 1.0


def test_an_effect_that_no_half_shows_is_said(result: LoopResult) -> None:
    stability = result.findings.stability
    assert stability is not None
    sentence = "On none of them: drift. Only a longer recording would show it on halves, too."
    for chosen, said in ((stability.chosen, False), ({"offset": 1.0}, True)):
        halves = stability.model_copy(update={"chosen": chosen})
        findings = result.findings.model_copy(update={"stability": halves})
        text = markdown(contents(Told(findings, result.new.extras, {"waterfall": WATERFALL})))
        assert (sentence in text) is said


def test_effects_that_cannot_be_told_apart_are_a_graph(result: LoopResult, tmp_path: Path) -> None:
    offset, drift = result.findings.effects
    both = (offset, drift.model_copy(update={"confounded_with": ("temperature", "gain")}))
    findings = result.findings.model_copy(update={"effects": both})
    assert not any(effect.confounded_with for effect in result.findings.effects)
    figure, caption = draw_confounded(findings)
    figure.savefig(tmp_path / "graph.png")
    graph = Picture("graph.png", "graph", caption)
    assert (tmp_path / "graph.png").read_bytes().startswith(PNG)
    text = markdown(contents(Told(findings, result.new.extras, {"confounded": graph})))
    told = text.split("\n## What cannot be told apart\n")[1].split("\n## ")[0]
    assert "drift cannot be told apart here from temperature and gain" in told
    assert "](graph.png)" in told


def test_lines_of_the_graph_go_around_what_they_do_not_join() -> None:
    axes = Figure().subplots()
    confounded_picture._join(axes, 0.0, 2.0, 0.0)
    (curve,) = axes.patches
    assert curve.get_path().interpolated(9).vertices[:, 0].min() < -0.4
    pairs = [("creep", "rate"), ("offset", "gain"), ("offset", "rate")]
    rows = {"offset": 0.0, "creep": 1.0}
    assert list(confounded_picture._places({"rate", "gain"}, pairs, rows)) == ["gain", "rate"]


def test_html_stands_alone(folder: Path) -> None:
    page = _Page()
    page.feed((folder / "report.html").read_text("utf-8"))
    assert not page.open
    assert not {"script", "link", "iframe"} & set(page.seen)
    assert len(page.sources) == len(list(folder.glob("*.png")))
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)


def test_an_earlier_report_is_replaced_and_nothing_else(
    folder: Path, result: LoopResult, tmp_path: Path
) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "thesis.tex").write_text("mine")
    with pytest.raises(SettingsError, match="not ours to replace"):
        write_report(kept, result)
    assert [path.name for path in kept.iterdir()] == ["thesis.tex"]
    again = tmp_path / "again"
    again.mkdir()
    (again / REPORT).write_text("{}")
    (again / "effect-9-gone.png").write_bytes(PNG)
    write_report(again, result)
    assert {path.name for path in again.iterdir()} == {path.name for path in folder.iterdir()}
    assert (again / "report.md").read_text() == (folder / "report.md").read_text()


def test_no_effect_reads_well(result: LoopResult) -> None:
    findings = result.findings.model_copy(update={"effects": (), "after": result.findings.before})
    lines = markdown(contents(Told(findings, [], {"waterfall": WATERFALL}))).splitlines()
    assert lines[2].endswith("and no effect was named.")
    opening = lines[lines.index("## In words") + 2]
    assert "No effect was named" in opening
    assert "Nothing was found that the model lacks." in opening
    assert "once corrected" not in opening


def test_the_nearest_candidates_were_tried(result: LoopResult) -> None:
    tried = result.findings.rejected[0].model_copy(update={"form": "line", "alone": -0.1, "name": "rate"})
    out_of_scope = tried.model_copy(update={"form": "", "alone": 0.0, "name": "location"})
    findings = result.findings.model_copy(update={"effects": (), "rejected": (out_of_scope, tried)})
    first = contents(Told(findings, [], {"waterfall": WATERFALL})).blocks
    table = next(block for block in first if isinstance(block, Table))
    assert [row[0] for row in table.rows] == ["rate"]


def test_waterfall_accounts_for_all_energy(result: LoopResult) -> None:
    whole, *parts = parts_of(result.findings)
    assert whole.stop - whole.start == 1.0
    assert sum(part.stop - part.start for part in parts) == pytest.approx(1.0)
    assert parts[-1].label == "noise"
    left = 1.0 - sum(effect.explained for effect in result.findings.effects)
    assert parts[-2].stop == pytest.approx(left)


def test_partial_residuals_differ_by_the_contribution(result: LoopResult) -> None:
    named = {one.name: one for one in result.attribution.named}
    partial = Partial.of(result, named["drift"])
    np.testing.assert_allclose(partial.before - partial.contribution, partial.after)
    assert set(partial.channels) == set(range(21)[DRIFTING])
    offset = Partial.of(result, named["offset"])
    shrunk = np.abs(offset.after.mean(axis=0)) < np.abs(offset.before.mean(axis=0))
    assert shrunk[list(offset.channels)].all()


def test_an_effect_that_changes_nothing_here_has_a_picture(result: LoopResult, tmp_path: Path) -> None:
    named = next(one for one in result.attribution.named if one.name == "drift")
    partial = Partial.of(result, replace(named, contribution=np.zeros_like(named.contribution)))
    assert len(partial.channels) == 4
    assert draw_effect(result, partial)[1]


@pytest.mark.parametrize(
    "name", [*(name for name in NAMES if name != "interference"), "covariate:material"]
)
def test_every_effect_can_be_drawn(result: LoopResult, name: str, tmp_path: Path) -> None:
    effect = next(one for one in candidates(result.observations) if one.label == name)
    partial = Partial.of(result, _named(result, effect))
    figure, caption = draw_effect(result, partial)
    figure.savefig(tmp_path / "effect.png")
    assert (tmp_path / "effect.png").read_bytes().startswith(PNG)
    assert caption.endswith(".")
    for channel in partial.channels:
        assert axis_of(result, partial, channel).values.shape == (result.blocks.evaluation.sum(),)


def test_a_wave_is_drawn_with_its_frequency_and_channels(result: LoopResult, tmp_path: Path) -> None:
    observations, blocks = result.observations, result.blocks
    random = np.random.default_rng(0)
    left = random.normal(size=observations.residual.shape)
    left[:, [4, 9]] += 5.0 * np.sin(2 * np.pi * 17.3 * observations.time_s)[:, None]
    remaining = Remaining(left, blocks.fit, np.ones(len(observations)))
    (wave,) = Interference().forms(observations, remaining)
    named = replace(_bare(result, wave), contribution=wave.basis.times(np.ones((len(CHANNELS), 1))))
    attribution = replace(result.attribution, residual=left - named.contribution)
    played = replace(result, attribution=attribution)
    figure, caption = draw_effect(played, Partial.of(played, named))
    figure.savefig(tmp_path / "wave.png")
    assert "in e3, e8, with and without the wave" in caption
    assert (tmp_path / "wave.png").read_bytes().startswith(PNG)


def test_offsets_of_contacts_are_drawn_with_what_a_calibration_brings(
    result: LoopResult, tmp_path: Path
) -> None:
    observations = result.observations
    offsets = np.random.default_rng(0).normal(size=(int(observations.segment.max()) + 1, len(CHANNELS)))
    form = ContactOffset().form(9.0 * offsets[observations.segment], {0.5: 0.4, 1.0: 0.5})
    named = replace(_bare(result, form), contribution=9.0 * offsets[observations.segment])
    figure, caption = draw_effect(result, Partial.of(result, named))
    figure.savefig(tmp_path / "contacts.png")
    assert "each contact's mean residual" in caption
    assert (tmp_path / "contacts.png").read_bytes().startswith(PNG)


def _named(result: LoopResult, effect: Effect) -> Named:
    """The first form of an effect, fitted to the first residual."""
    observations, blocks = result.observations, result.blocks
    residual, row_weights = observations.residual, np.ones(len(observations))
    candidate = next(iter(effect.forms(observations, Remaining(residual, blocks.fit, row_weights))))
    whitening = Whitening(Bins.of(blocks, DECLARED.bin_s), NoiseShape.usual(), residual, DECLARED)
    form = next(prepared(candidate, whitening))
    values, target = form.design.values, whitening(whitening.bins.means(residual.T[:, :, None]))
    gram = values.transpose(0, 2, 1) @ values + np.eye(form.size)
    weights = form.weights(np.linalg.solve(gram, values.transpose(0, 2, 1) @ target)[:, :, 0])
    bare = _bare(result, candidate)
    if candidate.moved is None:
        contribution = candidate.basis.times(weights)
    else:
        # Its change is predicted at some rows only.
        contribution = candidate.moved(observations).predicted - observations.predicted
    return replace(bare, weights=weights, contribution=contribution)


def _bare(result: LoopResult, candidate: Candidate) -> Named:
    """A form that changes nothing yet."""
    weights = np.ones((len(CHANNELS), candidate.basis.size))
    return Named(
        candidate=candidate,
        equation="",
        weights=weights,
        fold_weights=np.repeat(weights[None], 8, axis=0),
        served_share=np.ones(len(CHANNELS)),
        contribution=np.zeros_like(result.observations.residual),
        log_evidence=1.0,
        included=np.ones(len(CHANNELS)),
        p_value=0.01,
    )
