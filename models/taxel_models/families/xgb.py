"""XGBoost: one gradient-boosted forest for each of the 21 channels, as in the paper."""

from collections.abc import Mapping
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from pathlib import Path
from threading import Lock
from typing import Annotated, Any

import numpy as np
import xgboost
from numpy.typing import NDArray
from pydantic import Field
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.errors import ArtifactError
from taxel_models.families.family import (
    NO_EXTRAS,
    Family,
    FitTask,
    FittedModel,
    History,
    Hyperparameters,
    Progress,
)
from taxel_models.families.published import published
from taxel_models.families.xgb_merge import merge

Share = Annotated[float, Field(gt=0, le=1)]


class XgbHyperparameters(Hyperparameters):
    """The paper's search space, and what it left at XGBoost's defaults.

    `early_stopping_rounds`: trees without gain on the validation set before a channel stops;
    0 never stops early.
    """

    eta: Annotated[float, Field(gt=0, le=1)]
    gamma: Annotated[float, Field(ge=0)]
    n_estimators: Annotated[int, Field(ge=1, le=100_000)]
    max_depth: Annotated[int, Field(ge=1, le=32)]
    min_child_weight: Annotated[float, Field(ge=0)]
    max_delta_step: Annotated[float, Field(ge=0)]
    subsample: Share
    colsample_bytree: Share
    colsample_bylevel: Share
    colsample_bynode: Share
    max_bin: Annotated[int, Field(ge=2, le=65_536)] = 256
    early_stopping_rounds: Annotated[int, Field(ge=0)] = 20


class XgbModel(FittedModel):
    """21 fitted boosters in channel order.

    Args:
        boosters: of the channels.
        merged: all of them as one booster, which predicts in their place.
    """

    def __init__(
        self, boosters: tuple[xgboost.Booster, ...], merged: xgboost.Booster | None = None
    ) -> None:
        self.boosters, self._merged = boosters, merged

    def as_one_booster(self) -> "XgbModel":
        """The same model, with all trees in one booster: it predicts few rows faster, to the same bit."""
        merged = xgboost.Booster({"nthread": 1})
        merged.load_model(bytearray(merge(self.boosters)))
        return XgbModel(self.boosters, merged)

    @property
    @override
    def parameters(self) -> int:
        return sum(count_nodes(booster) for booster in self.boosters)

    @override
    def predict(
        self, windows: NDArray[np.float32], extras: Mapping[str, NDArray[np.float32]] = NO_EXTRAS
    ) -> NDArray[np.float32]:
        if self._merged is not None:
            # Of no rows, XGBoost forgets how many outputs there are.
            answers = self._merged.inplace_predict(windows).reshape(len(windows), len(self.boosters))
            return np.asarray(answers, np.float32)
        columns = [booster.inplace_predict(windows, iteration_range=(0, 0)) for booster in self.boosters]
        return np.stack(columns, axis=1).astype(np.float32, copy=False)

    @override
    def save(self, folder: Path) -> None:
        for channel, booster in zip(CHANNELS, self.boosters, strict=True):
            # Its own `save_model` raises an error of its own where the disk is full.
            (folder / f"{channel}.json").write_bytes(booster.save_raw("json"))


class _Watch(xgboost.callback.TrainingCallback):  # type: ignore[misc]
    """Counts the trees of all channels for the progress display."""

    def __init__(self, progress: Progress, total: int) -> None:
        super().__init__()
        self._progress = progress
        self._total = total
        self._done = 0
        self._lock = Lock()
        self.stopped = False
        """When it is set, every channel stops after its current tree."""

    @override
    def after_iteration(self, *_: Any) -> bool:
        self.advance(1)
        return self.stopped

    def advance(self, trees: int) -> None:
        """Count trees that were built, or that were not needed because training stopped early."""
        with self._lock:
            self._done += trees
            self._progress(self._done / self._total, f"{self._done} of {self._total} trees")


class XgbFamily(Family):
    """Gradient-boosted trees with the absolute error as objective."""

    name = "xgb"
    hyperparameters = XgbHyperparameters

    @override
    def paper_hyperparameters(self, combination: int) -> Mapping[str, Any]:
        return published(self.name, combination)

    @override
    def fit(self, task: FitTask, hyperparameters: Hyperparameters) -> tuple[XgbModel, History]:
        chosen = XgbHyperparameters.model_validate(hyperparameters.model_dump())
        watch = _Watch(task.progress, chosen.n_estimators * len(CHANNELS))

        def fit_some(columns: range) -> list[tuple[int, xgboost.Booster, list[float]]]:
            # One thread and one binned matrix for each worker: no result depends on their number.
            train = xgboost.QuantileDMatrix(task.train.windows, max_bin=chosen.max_bin, nthread=1)
            validation = xgboost.QuantileDMatrix(
                task.validation.windows, max_bin=chosen.max_bin, nthread=1, ref=train
            )
            fitted = []
            for column in columns:
                if watch.stopped:
                    break
                train.set_label(task.train.channels[:, column])
                validation.set_label(task.validation.channels[:, column])
                booster, losses = _fit_channel(train, validation, chosen, task.seed, watch)
                fitted.append((column, booster, losses))
            return fitted

        workers = max(1, min(task.jobs, len(CHANNELS)))
        shares = [range(start, len(CHANNELS), workers) for start in range(workers)]
        with ThreadPoolExecutor(workers) as pool:
            futures = [pool.submit(fit_some, share) for share in shares]
            try:
                wait(futures, return_when=FIRST_EXCEPTION)
            finally:
                # All are done, one failed, or the user interrupts: the others must stop.
                watch.stopped = True
        fitted = sorted(booster for future in futures for booster in future.result())
        boosters = tuple(booster for _, booster, _ in fitted)
        return XgbModel(boosters), _history(boosters, [losses for _, _, losses in fitted])

    @override
    def load(self, folder: Path) -> XgbModel:
        boosters = []
        for channel in CHANNELS:
            path = folder / f"{channel}.json"
            booster = xgboost.Booster()
            try:
                booster.load_model(path)
            except (xgboost.core.XGBoostError, OSError, ValueError) as error:
                reason = str(error).strip().splitlines()[-1]
                raise ArtifactError(f"{path}: not a model that XGBoost reads: {reason}") from None
            boosters.append(booster)
        return XgbModel(tuple(boosters))


def _fit_channel(
    train: xgboost.QuantileDMatrix,
    validation: xgboost.QuantileDMatrix,
    chosen: XgbHyperparameters,
    seed: int,
    watch: _Watch,
) -> tuple[xgboost.Booster, list[float]]:
    """One channel's booster, and its validation loss after each tree."""
    own = {"n_estimators", "early_stopping_rounds"}
    evaluations: dict[str, dict[str, list[float]]] = {}
    booster = xgboost.train(
        {
            **chosen.model_dump(exclude=own),
            "objective": "reg:absoluteerror",
            "eval_metric": "mae",
            "tree_method": "hist",
            "nthread": 1,
            "seed": seed,
        },
        train,
        num_boost_round=chosen.n_estimators,
        evals=[(validation, "validation")],
        evals_result=evaluations,
        early_stopping_rounds=chosen.early_stopping_rounds or None,
        verbose_eval=False,
        callbacks=[watch],
    )
    watch.advance(chosen.n_estimators - booster.num_boosted_rounds())
    if chosen.early_stopping_rounds:
        booster = booster[: booster.best_iteration + 1]
    booster.set_attr(best_iteration=None, best_score=None)
    return booster, evaluations["validation"]["mae"]


def _history(boosters: tuple[xgboost.Booster, ...], losses: list[list[float]]) -> History:
    """The mean loss over channels; one that stopped early stays at its best."""
    trees = [booster.num_boosted_rounds() for booster in boosters]
    steps = max(len(curve) for curve in losses)
    kept = np.stack(
        [np.pad(curve, (0, steps - len(curve)), constant_values=min(curve)) for curve in losses]
    )
    return History(
        unit="tree of every channel",
        loss="mean absolute error, z-scores",
        train=(),
        validation=tuple(kept.mean(axis=0).tolist()),
        best=max(trees),
        notes={"trees": dict(zip(CHANNELS, trees, strict=True))},
    )


def count_nodes(booster: xgboost.Booster) -> int:
    """Nodes of all trees, leaves included: the paper's parameter count."""
    return sum(text.count("\n") for text in booster.get_dump())
