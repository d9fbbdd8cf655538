"""A study small enough for tests."""

from collections.abc import Callable
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner, Result

from taxel.commands.cli import failing_clearly
from taxel_models.commands.study import study as command
from taxel_models.recordings import Recording, write_ruppel
from taxel_models.study.study_settings import StudySettings
from taxel_models.twin import simulate


@pytest.fixture(scope="session")
def twin() -> Recording:
    return simulate(9000, 5)


@pytest.fixture(scope="session")
def twin_csv(twin: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("twin") / "twin.csv"
    write_ruppel(twin, path)
    return path


@pytest.fixture(scope="session")
def small_settings() -> StudySettings:
    """Two models, two combinations, three folds; a network as small as one can be."""
    return StudySettings(
        models=("network-b", "xgb"),
        combinations=(1, 2),
        folds=3,
        overrides={
            "xgb": {"n_estimators": 2, "max_depth": 3, "min_child_weight": 1},
            "network-b": {
                "epochs": 2,
                "position_column": [4],
                "force_column": [4],
                "temperature_column": [2],
                "trunk": [4],
                "batch_size": 4096,
            },
        },
    )


@pytest.fixture
def taxel_study() -> Callable[..., Result]:
    """`taxel study` with these arguments."""

    def run(*arguments: str | Path) -> Result:
        app = typer.Typer(pretty_exceptions_enable=False)
        app.command()(failing_clearly(command))
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    return run
