"""A correction becomes a new version beside the old, checked, or nothing at all."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import taxel
from taxel import artifacts
from taxel.channels import CHANNELS
from taxel.corrections import CALIBRATION_EXTRAS, AppliedEffect, Correction, Parameter, Weighted
from taxel.errors import ArtifactError, NotFound
from taxel.windows import ExtraFeature, Relaxation
from taxel_exporters.corrected import export_corrected
from taxel_models.shipped import shipped_repository
from taxel_server.runtimes.corrected import CorrectedRuntime

CREEP = ExtraFeature(
    name="creep", unit="N", history=Relaxation(of="force", time_constant_s=1.0), taken_by="effects"
)

MATERIAL = ExtraFeature(name="material", unit="0 or 1", taken_by="effects")


def adding(name: str, feature: str, weight: float, shift: int = 0) -> AppliedEffect:
    term = Weighted(shape="unit", features=(feature,), references=(0.0,), weights=((weight,) * 21,))
    parameter = Parameter(name="weight", value=weight, unit="counts")
    return AppliedEffect(
        name=name,
        about=f"Adds {feature}.",
        channels=CHANNELS,
        parameters=(parameter,),
        terms=(term,),
        shift_ticks=shift,
    )


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """Version 1 of the shipped `ffnn`, an ONNX model."""
    shutil.copytree(shipped_repository() / "ffnn", tmp_path / "ffnn")
    return tmp_path


@pytest.fixture
def windows() -> NDArray[np.float32]:
    """Twelve values each, near the mean of what the models were trained on."""
    statistics = artifacts.read(shipped_repository() / "ffnn" / "1").manifest.normalisation
    draws = np.random.default_rng(0).normal(size=(64, 12))
    return (draws * statistics.input_std + statistics.input_mean).astype(np.float32)


def test_a_new_version_lies_beside_the_old(repository: Path, windows: NDArray[np.float32]) -> None:
    effect = adding("creep", "creep", 40.0, shift=3)
    manifest = export_corrected(repository, "ffnn", "1", [effect], [CREEP], windows=windows)
    assert (manifest.version, manifest.effects, manifest.window.shift) == ("2", (effect,), 3)
    assert manifest.window.look_ahead == 7
    assert manifest.window.features[-2:] == ("fz[+7]", "creep")
    assert manifest.parity is not None
    assert manifest.parity.windows == 64
    old, new = (artifacts.read(repository / "ffnn" / version) for version in ("1", "2"))
    assert new.manifest == manifest
    assert old.model_path.read_bytes() == new.model_path.read_bytes()
    with taxel.load(repository) as source:
        before, after = (source.predictor("ffnn", version) for version in ("1", "2"))
        inputs = np.hstack([windows, np.full((64, 1), 0.5, np.float32)])
        np.testing.assert_allclose(after.predict(inputs), before.predict(windows) + 20.0, atol=0.01)


def test_a_correction_of_a_correction_has_both(repository: Path, windows: NDArray[np.float32]) -> None:
    export_corrected(
        repository, "ffnn", None, [adding("creep", "creep", 40.0, 3)], [CREEP], windows=windows
    )
    more = [adding("offset", "one", 5.0, -1), adding("slow creep", "creep", 2.0)]
    manifest = export_corrected(repository, "ffnn", None, more, [CREEP], windows=windows)
    assert manifest.version == "3"
    assert [effect.name for effect in manifest.effects] == ["creep", "offset", "slow creep"]
    assert manifest.window.shift == 2
    assert manifest.window.extras == (CREEP,)
    with taxel.load(repository) as source:
        before, after = (source.predictor("ffnn", version) for version in ("1", "3"))
        inputs = np.hstack([windows, np.ones((64, 1), np.float32)])
        np.testing.assert_allclose(after.predict(inputs), before.predict(windows) + 47.0, atol=0.01)


def test_what_the_version_has_already_is_not_repeated(
    repository: Path, windows: NDArray[np.float32]
) -> None:
    heat = ExtraFeature(name="tdc", unit="counts", default=1900.0, taken_by="effects")
    effects = [adding("creep", "creep", 40.0), adding("temperature", "tdc", 0.01)]
    export_corrected(repository, "ffnn", "1", effects, [CREEP, heat], windows=windows)
    # Another recording's mean is another default.
    extras = [heat.model_copy(update={"default": 1950.0}), MATERIAL, CREEP]
    more = [adding("temperature", "tdc", 0.02), adding("material", "material", 3.0)]
    more.append(adding("creep", "creep", -10.0))
    given = np.column_stack([windows, *([value] * 64 for value in (0.5, 2000.0, 2000.0, 1.0, 0.5))])
    manifest = export_corrected(repository, "ffnn", "2", more, extras, windows=given.astype(np.float32))
    assert manifest.window.extras == (CREEP, heat, MATERIAL)
    with taxel.load(repository) as source:
        before, after = (source.predictor("ffnn", version) for version in ("1", "3"))
        inputs = given[:, [*range(14), 15]]
        np.testing.assert_allclose(after.predict(inputs), before.predict(windows) + 78.0, atol=0.01)


def test_one_name_has_one_meaning(repository: Path, windows: NDArray[np.float32]) -> None:
    export_corrected(repository, "ffnn", "1", [adding("creep", "creep", 40.0)], [CREEP], windows=windows)
    slower = CREEP.model_copy(update={"history": Relaxation(of="force", time_constant_s=2.0)})
    with pytest.raises(ArtifactError, match="'creep' is another feature in ffnn/2"):
        export_corrected(
            repository, "ffnn", "2", [adding("creep", "creep", 1.0)], [slower], windows=windows
        )


def test_its_card_names_the_effects_and_what_they_need(
    repository: Path, windows: NDArray[np.float32]
) -> None:
    channels = [f"calibration_{channel}" for channel in CHANNELS]
    offsets = Weighted(
        shape="unit",
        features=tuple(channels),
        references=(0.0,) * 21,
        weights=tuple(tuple(row) for row in np.eye(21).tolist()),
    )
    contact = AppliedEffect(name="offset", about="Contacts differ.", channels=CHANNELS, terms=(offsets,))
    effects = [adding("creep", "creep", 40.0), contact]
    export_corrected(repository, "ffnn", "1", effects, [CREEP, *CALIBRATION_EXTRAS], windows=windows)
    card = (repository / "ffnn" / "2" / "README.md").read_text()
    assert "- `creep`: Adds creep. (weight 40 counts)" in card
    assert "- `creep` (N), computed by the window builder" in card
    assert "- `calibration_e19` (counts), given by the caller; 0 where it is not." in card
    assert "with the effects added apart" in card


def test_what_does_not_fit_together_writes_nothing(repository: Path, windows: NDArray[np.float32]) -> None:
    wrong = [
        ([adding("creep", "creep", 1.0)], [], r"ffnn/1 cannot be corrected so: .*takes \['creep'\]"),
        ([adding("offset", "one", 1.0)], [CREEP], "no effect takes them"),
        ([adding("lag", "one", 1.0, 60), adding("lag", "one", 1.0, 60)], [], "shift 120"),
    ]
    for effects, extras, message in wrong:
        with pytest.raises(ArtifactError, match=message):
            export_corrected(repository, "ffnn", "1", effects, extras, windows=windows)
    with pytest.raises(NotFound, match="no version '7'"):
        export_corrected(repository, "ffnn", "7", [adding("offset", "one", 1.0)], windows=windows)
    assert sorted(path.name for path in (repository / "ffnn").iterdir()) == ["1"]


def served_as_one_more(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluate = CorrectedRuntime.evaluate
    monkeypatch.setattr(CorrectedRuntime, "evaluate", lambda self, given: evaluate(self, given) + 1)


def base_of_other_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    base = Correction.base
    reverse = np.s_[:, ::-1]
    monkeypatch.setattr(Correction, "base", lambda self, run, given: base(self, run, given[reverse].copy()))


def terms_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Correction, "add", lambda self, base, windows: base.copy())


@pytest.mark.parametrize("fault", [served_as_one_more, base_of_other_columns, terms_left_out])
def test_what_is_served_otherwise_is_not_written(
    fault: Callable[[pytest.MonkeyPatch], None],
    repository: Path,
    windows: NDArray[np.float32],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fault(monkeypatch)
    with pytest.raises(ArtifactError, match=r"parity: window \d+, channel \w+: the artifact gives"):
        export_corrected(repository, "ffnn", "1", [adding("offset", "one", 1.0)], windows=windows)
    assert sorted(path.name for path in (repository / "ffnn").iterdir()) == ["1"]
