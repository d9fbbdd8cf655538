"""Which ground rounds are played on: what `taxel loop-trial` is told, checked before anything is read."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taxel.dependencies import require
from taxel.errors import SettingsError
from taxel_models.ground import GroundName
from taxel_models.ground.ground import Ground
from taxel_models.ground.several_models import SeveralModels
from taxel_models.ground.twins import StoredModel, TwinGround
from taxel_models.recovery.injected import InjectorKind
from taxel_models.recovery.own_ground import CleanTwins


@dataclass(frozen=True)
class ChosenGround:
    """A ground by its name, and what it needs.

    Attributes:
        name: `twin`, or one of the real recordings.
        seed: of the recordings.
        model: answers for twins; real grounds train their own.
        injector: the own injectors have twins of their own.
        rows: of each twin.
        data: the folder of the real recordings, or the one above; None for twins.
        jobs: processes that train.
        one_of: a column; each round plays one of its values. Slide only, as the two below.
        unseen: the model was not trained on some of the values, or on some materials.
        all_days: a round plays trials of all days, in place of one.
        models: base models that take turns, each trained on other trials. Real grounds only.
    """

    name: GroundName
    seed: int
    model: StoredModel
    injector: InjectorKind = "own"
    rows: int = 60_000
    data: Path | None = None
    jobs: int = 1
    one_of: str | None = None
    unseen: bool = False
    all_days: bool = False
    models: int = 1

    def __post_init__(self) -> None:
        if self.one_of is not None and self.name != "slide":
            raise SettingsError(
                f"--one-of {self.one_of}: only --ground slide has kinds; this is --ground {self.name}"
            )
        if self.unseen and self.name != "slide":
            raise SettingsError(f"--unseen: only --ground slide has kinds; this is --ground {self.name}")
        if self.all_days and (self.name != "slide" or self.one_of is not None):
            raise SettingsError("--all-days: only --ground slide has days, and not with --one-of")
        if self.models > 1 and self.name == "twin":
            raise SettingsError(f"--models {self.models}: twins have one model, that of --model")
        if self.name != "twin" and self.data is None:
            raise SettingsError(f"--ground {self.name}: expected --data, the folder of the real recordings")

    def prepare(self, note: Callable[[str], None] | None = None) -> Ground:
        """Read and train what the rounds need.

        Args:
            note: is told which base model is trained, where there are several.

        Raises:
            RecordingError: the real recordings are not there, are damaged, or are too few.
            MissingDependency: real grounds train with XGBoost.
        """
        if self.data is None or self.name == "twin":
            if self.injector == "own":
                return CleanTwins(self.model, self.seed, self.rows)
            return TwinGround(self.model, self.seed, self.rows)
        require(f"--ground {self.name}", "train", "xgboost")
        if self.models == 1:
            return self._real(self.data, self.seed)
        grounds = []
        for model in range(self.models):
            if note is not None:
                note(f"base model {model + 1} of {self.models}")
            grounds.append(self._real(self.data, self._seed_of(model)))
        return SeveralModels(tuple(grounds))

    def _seed_of(self, model: int) -> int:
        """The first model is the one that it would be alone."""
        return (
            self.seed if model == 0 else int(np.random.default_rng([self.seed, model, 4]).integers(1 << 31))
        )

    def _real(self, data: Path, seed: int) -> Ground:
        from taxel_models.ground.real import RealGround, real_data

        folder = real_data(data)
        if self.name == "lasa":
            return RealGround.lasa(folder, seed, self.jobs)
        return RealGround.slide(
            folder, seed, self.jobs, self.one_of, unseen=self.unseen, all_days=self.all_days
        )
