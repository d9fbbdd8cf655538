from collections.abc import Callable

import pytest

from taxel_models.families.family import FitTask
from taxel_models.recordings import Recording
from taxel_models.search.objective import fit_task
from taxel_models.search.search_settings import SearchSettings
from taxel_models.twin import simulate

TINY_XGB = {"n_estimators": 1, "max_depth": 2}
TINY_TRANSFORMER = {"embedding": 32, "hidden": 64, "layers": 2, "heads": 1}


@pytest.fixture(scope="session")
def recording() -> Recording:
    return simulate(4000, 3)


@pytest.fixture(scope="session")
def planned(recording: Recording) -> Callable[..., tuple[SearchSettings, FitTask]]:
    """A search of a few seconds: its settings, and the task to fit to."""

    def make(family: str = "xgb", **settings: object) -> tuple[SearchSettings, FitTask]:
        tiny = {"xgb": TINY_XGB, "transformer": TINY_TRANSFORMER}[family]
        chosen = {"trials": 4, "held": tiny, "grouping": "chunks", **settings}
        made = SearchSettings.of([recording], family=family, **chosen)
        return made, fit_task([recording], made, 1)

    return make
