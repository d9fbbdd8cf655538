"""Corrected artifacts, small enough to be measured in a test."""

import shutil
from pathlib import Path

import pytest

from taxel import artifacts
from taxel.channels import CHANNELS
from taxel.corrections import AppliedEffect, Weighted
from taxel.windows import ExtraFeature, Relaxation
from taxel_bench.windows import random_windows
from taxel_exporters.corrected import export_corrected
from taxel_exporters.export import export
from taxel_models.shipped import shipped_repository
from taxel_server.runtimes.compiled.compiling import cache_folder

CREEP = ExtraFeature(
    name="creep", unit="N", history=Relaxation(of="fz", time_constant_s=0.3), taken_by="effects"
)
TEMPERATURE = ExtraFeature(name="tdc", unit="counts", default=2000.0, taken_by="effects")
EFFECTS = (
    AppliedEffect(name="lag", about="Channels trail the contact.", channels=CHANNELS, shift_ticks=2),
    AppliedEffect(
        name="creep",
        about="Channels relax after the load changes.",
        channels=CHANNELS,
        terms=(
            Weighted(
                shape="unit",
                features=("one", "creep", "tdc"),
                references=(0.0, 0.0, 1990.0),
                weights=((5.0,) * 21, (40.0,) * 21, (0.5,) * 21),
            ),
        ),
    ),
)
"""At the extras' defaults they come to 10 counts."""


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user's cache folder in which no peer is installed; compiled code is kept where it always is."""
    kept = cache_folder()
    if kept is not None:
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(kept.parent))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(params=["trees", "network"])
def corrected(request: pytest.FixtureRequest, trained_folder: Path, tmp_path: Path) -> Path:
    """The folder of a model that is corrected in version 2; version 1 lies beside it."""
    if request.param == "trees":
        export(trained_folder, tmp_path, name="skin")
    else:
        shutil.copytree(shipped_repository() / "ffnn", tmp_path / "ffnn")
    (model,) = tmp_path.iterdir()
    windows = random_windows(artifacts.read(model / "1").manifest, 16, seed=1)
    export_corrected(tmp_path, model.name, "1", EFFECTS, (CREEP, TEMPERATURE), windows=windows)
    return model / "2"
