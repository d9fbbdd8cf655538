"""From a tie to a protocol, to a recording of it on the twin, to a decision."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from taxel.channels import COUNTS_MAX
from taxel_models.commands.twin import twin
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining
from taxel_models.loop.effects.lag import Lag
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.effects.registry import NAMES
from taxel_models.loop.findings import Findings
from taxel_models.loop.next_recording.fitted import Fitted
from taxel_models.loop.next_recording.proposals import propose
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.pipeline import LoopResult, LoopSettings, run_loop
from taxel_models.loop.report.report import write_report
from taxel_models.recordings import Recording, read_recording
from taxel_models.twin import simulate
from taxel_models.twin.protocol import read_protocol

PAIR: Final = ("drift", "temperature")
SETTINGS: Final = LoopSettings(exclude=tuple(name for name in NAMES if name not in (*PAIR, "offset")))
START_TDC: Final = 1853.0

Caused = Callable[[Recording, str], Recording]


@pytest.fixture(scope="module")
def caused(smooth: Any) -> Caused:
    """The same places and forces, with the smooth model's counts, noise, and one of the two causes.

    Both change ln Z of all electrodes about alike. In a recording of a cold finger both rise for as long as
    it lasts.
    """
    alike = np.random.default_rng(1).normal(1.0, 0.15, 21)
    alike[:2] = 0.0

    def with_cause(recording: Recording, cause: str) -> Recording:
        samples = recording.samples
        counts = smooth.counts(samples.position, samples.force)
        time_s = (samples.time_ns - samples.time_ns[0]) / 1e9
        course = {
            "drift": time_s / 1000.0,
            "temperature": (recording.auxiliary["tdc"] - START_TDC) / 6.0,
        }[cause]
        delta = 0.03 * course[:, None] * counts * (1.0 - counts / COUNTS_MAX) * alike
        noise = np.random.default_rng(5).normal(size=counts.shape) * 4.0
        channels = np.clip(np.rint(counts + delta + noise), 0, COUNTS_MAX)
        return replace(recording, channels=channels)

    return with_cause


@pytest.fixture(scope="module")
def tied(smooth: Any, caused: Caused) -> LoopResult:
    """The loop on a minute and a half of a cold finger."""
    return run_loop(smooth, [caused(simulate(9_000, 3), "temperature")], SETTINGS)


@pytest.fixture(scope="module")
def proposed(tied: LoopResult) -> LoopResult:
    return propose(tied)


@pytest.fixture(scope="module")
def report(proposed: LoopResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loop") / "report"
    write_report(folder, proposed)
    return folder


def test_the_proposed_recording_decides(
    smooth: Any, caused: Caused, proposed: LoopResult, report: Path, tmp_path: Path
) -> None:
    first = {effect.name: effect for effect in proposed.findings.effects}
    assert first["temperature"].confounded_with == ("drift",)
    (found,) = proposed.findings.next_recordings
    assert set(found.causes) == set(PAIR)
    assert found.right >= 8
    app = typer.Typer()
    app.command()(twin)
    output = tmp_path / "next.csv"
    arguments = ["--protocol", str(report / found.file), "--seed", "11", "-o", str(output)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    for cause, other in (PAIR, PAIR[::-1]):
        decided = run_loop(smooth, [caused(read_recording(output), cause)], SETTINGS).findings.effects
        named = {effect.name: effect for effect in decided}
        assert cause in named
        assert other not in named
        assert other not in named[cause].confounded_with


def test_the_report_says_what_to_do(proposed: LoopResult, report: Path) -> None:
    (found,) = proposed.findings.next_recordings
    assert found.protocol == read_protocol(report / found.file)
    text = (report / "report.md").read_text("utf-8")
    assert "## What to record next" in text
    assert f"{found.right} of {found.simulated}" in text
    written = (report / "report.json").read_text("utf-8")
    assert Findings.model_validate_json(written).next_recordings == (found,)


def test_what_can_be_told_needs_no_recording(tied: LoopResult) -> None:
    told = tuple(replace(named, confounded_with=()) for named in tied.attribution.named)
    certain = replace(tied, attribution=replace(tied.attribution, named=told))
    assert propose(certain).findings.next_recordings == ()


def test_a_fitted_cause_acts_on_another_recording_as_it_did(
    smooth: Any, caused: Caused, tied: LoopResult
) -> None:
    """On the recording that it was fitted to it gives its contribution, on another one what is there."""
    (temperature,) = (named for named in tied.attribution.named if named.name == "temperature")
    fitted = Fitted.of(temperature)
    change = fitted.counts(tied.observations) - tied.observations.predicted
    np.testing.assert_allclose(change, temperature.contribution, atol=1e-6)
    other = gather(smooth, [caused(simulate(9_000, 8), "temperature")])
    expected = caused(simulate(9_000, 8), "temperature").channels[other.rows[0]] - other.predicted
    about = fitted.counts(other) - other.predicted
    left = (expected - expected.mean(axis=0)) - (about - about.mean(axis=0))
    assert left.std(axis=0).max() < 6.0


def test_what_is_only_reported_foretells_nothing(tied: LoopResult) -> None:
    def forms(effect: Effect, of: Observations) -> list[Candidate]:
        every = np.ones(len(of))
        return [*effect.forms(of, Remaining(of.residual, every.astype(bool), every))]

    delays = {delay.form: delay for delay in forms(Lag(), tied.observations)}
    ones = np.ones((21, 1))
    assert Fitted(delays["20 ms"], ones).foretells
    # A window moves by whole ticks.
    assert not Fitted(delays["15 ms"], ones).foretells
    constant, calibrated, *_ = forms(Offset(), tied.observations.calibrated(0.5))
    assert Fitted(constant, ones).foretells
    assert "calibration" in calibrated.form
    assert not Fitted(calibrated, ones).foretells


def test_no_protocol_is_simulated_where_a_cause_foretells_nothing(
    tied: LoopResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would crash with a calibration: contacts that are still to come have none."""

    def rehearse(*_: object, **__: object) -> None:
        raise AssertionError("simulated")

    monkeypatch.setattr(Fitted, "foretells", property(lambda _: False))
    monkeypatch.setattr("taxel_models.loop.next_recording.proposals.rehearse", rehearse)
    (proposal, *_) = propose(tied).findings.next_recordings
    assert proposal.protocol is None
    assert not proposal.can_be_simulated
