"""The folder that the loop's findings are written to."""

import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import SettingsError
from taxel.manifest import Manifest
from taxel_models.loop.attribution import Named
from taxel_models.loop.closing import Closed, Plan, close_loop
from taxel_models.loop.effects.effect import Effect, Left
from taxel_models.loop.effects.registry import NAMES, candidates
from taxel_models.loop.findings import Findings
from taxel_models.loop.moments import Moments
from taxel_models.loop.report.drivers import axis_of
from taxel_models.loop.report.effect_pictures import draw_effect
from taxel_models.loop.report.error_pictures import bars
from taxel_models.loop.report.partial import Partial
from taxel_models.loop.report.report import REPORT, write_report
from taxel_models.loop.scoring import score
from taxel_models.recordings import Recording

ROWS = 7000
LOOKED_FOR = ("offset", "drift")
DRIFTING = slice(10, 14)
STUCK = CHANNELS.index("e18")
PNG = b"\x89PNG"


class Model(Protocol):
    """As `smooth` is."""

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]: ...


@pytest.fixture(scope="module")
def closed(manifest: Manifest, smooth: Model, make: Callable[..., Recording]) -> Closed:
    """The loop on a model that lacks an offset in e1 to e6 and a drift in e9 to e12.

    e18 is stuck off and on, which is not looked for.
    """
    recording = make(ROWS)
    channels = recording.channels.copy()
    channels[:, 2:8] += 60
    channels[:, DRIFTING] += np.linspace(0, 150, ROWS)[:, None]
    channels[:, STUCK] = np.where(np.arange(ROWS) % 1000 < 300, 1500, channels[:, STUCK])
    others = tuple(name for name in NAMES if name not in LOOKED_FOR)
    plan = Plan(exclude=(*others, "covariate:material"))
    auxiliary = {**recording.auxiliary, "tdc": np.linspace(1900, 1990, ROWS)}
    recording = replace(recording, channels=channels, auxiliary=auxiliary)
    return close_loop(manifest, smooth.predict, [recording], plan)


@pytest.fixture(scope="module")
def folder(closed: Closed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("loop") / "report"
    write_report(place, closed)
    return place


class _Page(HTMLParser):
    """Which elements a page has, and whether each is closed."""

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


def test_json_is_the_findings(folder: Path, closed: Closed) -> None:
    assert Findings.model_validate_json((folder / REPORT).read_text("utf-8")) == closed.findings


def test_markdown_shows_every_picture_and_effect(folder: Path, closed: Closed) -> None:
    text = (folder / "report.md").read_text("utf-8")
    shown = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    assert {path.name for path in folder.glob("*.png")} == set(shown)
    assert all((folder / name).read_bytes().startswith(PNG) for name in shown)
    assert {effect.name for effect in closed.findings.effects} == {"offset", "drift"}
    for effect in closed.findings.effects:
        assert f"\n## {effect.name}\n" in text


def test_html_stands_alone(folder: Path) -> None:
    page = _Page()
    page.feed((folder / "report.html").read_text("utf-8"))
    assert not page.open
    assert not {"script", "link", "iframe"} & set(page.seen)
    assert len(page.sources) == len(list(folder.glob("*.png")))
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)


def test_an_earlier_report_is_replaced_and_nothing_else(
    folder: Path, closed: Closed, tmp_path: Path
) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "thesis.tex").write_text("mine")
    with pytest.raises(SettingsError, match="not ours to replace"):
        write_report(kept, closed)
    assert [path.name for path in kept.iterdir()] == ["thesis.tex"]
    again = tmp_path / "again"
    again.mkdir()
    (again / REPORT).write_text("{}")
    (again / "effect-9-gone.png").write_bytes(PNG)
    write_report(again, closed)
    assert {path.name for path in again.iterdir()} == {path.name for path in folder.iterdir()}
    assert (again / "report.md").read_text() == (folder / "report.md").read_text()


def test_no_effect_reads_well(closed: Closed, tmp_path: Path) -> None:
    findings = closed.findings.model_copy(update={"effects": (), "after": closed.findings.before})
    nothing = replace(closed, findings=findings, after=closed.evidence.predicted)
    write_report(tmp_path / "report", nothing)
    opening = (tmp_path / "report" / "report.md").read_text("utf-8").splitlines()[2]
    assert "No effect was named" in opening
    assert "There is nothing to add to the model." in opening
    assert "once corrected" not in opening
    assert not list((tmp_path / "report").glob("effect-*.png"))


def test_waterfall_accounts_for_all_energy(closed: Closed) -> None:
    whole, *parts = bars(closed.findings)
    assert whole.stop - whole.start == 1.0
    assert sum(part.stop - part.start for part in parts) == pytest.approx(1.0)
    assert parts[-1].label == "noise"
    left = 1.0 - sum(effect.explained for effect in closed.findings.effects)
    assert parts[-2].stop == pytest.approx(left)


def test_partial_residuals_differ_by_the_contribution(closed: Closed) -> None:
    named = {one.name: one for one in closed.attribution.named}
    partial = Partial.of(closed, named["drift"])
    np.testing.assert_allclose(partial.before - partial.contribution, partial.after)
    assert set(partial.channels) == set(range(21)[DRIFTING])
    offset = Partial.of(closed, named["offset"])
    shrunk = np.abs(offset.after.mean(axis=0)) < np.abs(offset.before.mean(axis=0))
    assert shrunk[list(offset.channels)].all()


@pytest.mark.parametrize("name", [*NAMES, "covariate:material"])
def test_every_effect_can_be_drawn(closed: Closed, name: str, tmp_path: Path) -> None:
    effect = next(one for one in candidates(closed.evidence) if one.label == name)
    partial = Partial.of(closed, _named(closed, effect))
    caption = draw_effect(closed, partial, tmp_path / "effect.png")
    assert (tmp_path / "effect.png").read_bytes().startswith(PNG)
    assert caption.endswith(".")
    for channel in partial.channels:
        assert axis_of(closed, partial, channel).values.shape == (closed.blocks.evaluation.sum(),)


def _named(closed: Closed, effect: Effect) -> Named:
    """The first form of an effect, fitted to the first residual."""
    evidence, blocks = closed.evidence, closed.blocks
    residual, trust = evidence.measured - evidence.predicted, np.ones(len(evidence))
    candidate = next(iter(effect.forms(evidence, Left(residual, blocks.fit, trust))))
    moments = Moments.of(candidate.basis, residual, trust, blocks, candidate.fitting)
    scale = np.ones(len(CHANNELS))
    weights = moments.weights(scale)
    fitted = score(candidate, moments, scale)
    return Named(effect, fitted, weights, candidate.basis.times(weights), 0.005)
