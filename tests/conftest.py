"""Fixtures that several rooms' tests share."""

import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import settings

# pytest-xdist tells its workers a width, which tables would keep whatever a test asks for.
os.environ.pop("COLUMNS", None)

# A shell without job control ignores Ctrl-C in what it starts in the background, and so would every program
# that the tests start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

CHECKOUT = Path(__file__).resolve().parent.parent

# A busy machine makes an example slow, not wrong.
settings.register_profile("taxel", deadline=None)
settings.load_profile("taxel")


@pytest.fixture(scope="session")
def trained_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small XGBoost model for input combination 1, trained on a few seconds of the twin.

    As an earlier version left it, without the rows that it was fitted to: what it gets wrong anyway takes
    most of the time of an export, and few tests ask for it.
    """
    # Imported here, so that the tests of serving run where no training library is installed.
    from taxel_models.training import trained as trained_models
    from taxel_models.training.split import SplitSettings
    from taxel_models.training.train import TrainingSettings, train
    from taxel_models.twin import simulate

    hyperparameters = {"n_estimators": 8, "max_depth": 4, "eta": 0.4, "min_child_weight": 5}
    settings = TrainingSettings("xgb", 1, SplitSettings("chunks"), overrides=hyperparameters)
    model, kept = train([simulate(8000, 3)], settings)
    folder = tmp_path_factory.mktemp("training") / "trained"
    trained_models.save(model, replace(kept, fitted=()), folder)
    return folder


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real recordings; it holds `biotac_slide` and `lasa_contact`."""
    named = os.environ.get("TAXEL_DATA")
    places = [Path(named), Path(named) / "data"] if named else [CHECKOUT.parent / "shared" / "data"]
    for place in places:
        if (place / "biotac_slide").is_dir():
            return place
    pytest.skip(f"no real recordings in {places[0]}: set TAXEL_DATA to the folder that holds biotac_slide")
