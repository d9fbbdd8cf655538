"""Stand-ins: small trees predict rows in the place of a model that has seen them, or others like them.

A model errs less on rows that it was fitted to than on those of another day. Each row is predicted by trees
that were fitted to other rows (cross-fitting): of other contacts, or of other kinds, such as materials.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.manifest import Manifest
from taxel.scaling import Scaler
from taxel_models.loop.observations import FEWEST_CONTACTS, Observations

GROUPS_OF_KINDS: Final = 4
"""Kinds are left out a quarter at a time."""

GROUPS_OF_CONTACTS: Final = 2
"""Contacts are left out a half at a time."""

GROUPS_OF_FEW: Final = 4
"""Few contacts are left out a quarter at a time. Half of 23 contacts tell much less than all: stand-ins
that saw half erred by up to twice as much as the model."""

MANY_CONTACTS: Final = 100
"""From so many on, contacts are not few. Only 23 and several hundred were tried."""

TREES: Final = 40

SMALL: Final = {
    # Models are fitted to absolute errors, too, and so predict medians.
    "objective": "reg:absoluteerror",
    "tree_method": "hist",
    "eta": 0.2,
    "max_depth": 6,
    "min_child_weight": 20,
    "max_bin": 128,
    # The sums of a tree depend on the number of threads.
    "nthread": 1,
}


@dataclass(frozen=True)
class StandIns:
    """Trees in the place of a model. Behind its window, a row has the number of those that predict it.

    Attributes:
        manifest: of the model.
        boosters: each was fitted to the rows of all numbers but its own.
        targets: their scales.
    """

    manifest: Manifest
    boosters: tuple[Any, ...]
    targets: tuple[Scaler, ...]

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 21) counts of windows (n, f + 1)."""
        counts = np.zeros((len(windows), len(CHANNELS)), np.float32)
        for number, (booster, targets) in enumerate(zip(self.boosters, self.targets, strict=True)):
            own = windows[:, -1] == number
            if own.any():
                counts[own] = targets.restore(booster.inplace_predict(windows[own, :-1]))
        return counts

    def predict_base(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The same as `predict`: stand-ins have no effects."""
        return self.predict(windows)


def without_their_contact(observations: Observations) -> Observations | None:
    """The same rows, each predicted by trees that never saw its contact; None of few contacts."""
    contacts = np.random.default_rng(0).permutation(np.unique(observations.contact))
    if len(contacts) < FEWEST_CONTACTS:
        return None
    groups = GROUPS_OF_CONTACTS if len(contacts) >= MANY_CONTACTS else GROUPS_OF_FEW
    return _left_out(observations, observations.contact, np.array_split(contacts, groups))


def without_their_kind(observations: Observations, column: str) -> Observations:
    """The same rows, each predicted by trees that never saw its kind.

    Args:
        column: that names at least two kinds.
    """
    values = observations.covariates[column]
    kinds = np.random.default_rng(0).permutation(np.unique(values))
    return _left_out(observations, values, np.array_split(kinds, min(GROUPS_OF_KINDS, len(kinds))))


def _left_out(observations: Observations, of_row: NDArray[Any], groups: list[NDArray[Any]]) -> Observations:
    """The same rows, each predicted by trees that were fitted to those of other groups.

    Args:
        of_row: (n,) what groups hold some of.
    """
    # `taxel[loop]` alone has no XGBoost, and needs it only where a model is exported.
    import xgboost

    measured = observations.measured.astype(np.float32)
    # Stand-ins may stand in for others, which have a number of their own.
    windows = observations.windows[:, : len(observations.manifest.window.features)]
    number = np.zeros((len(observations), 1), np.float32)
    boosters, scales = [], []
    for place, group in enumerate(groups):
        left_out = np.isin(of_row, group)
        number[left_out] = place
        targets = Scaler.fit(measured[~left_out])
        train = xgboost.QuantileDMatrix(
            windows[~left_out],
            targets.normalise(measured[~left_out]),
            max_bin=SMALL["max_bin"],
            nthread=SMALL["nthread"],
        )
        boosters.append(xgboost.train(SMALL, train, TREES))
        scales.append(targets)
    model = StandIns(observations.manifest, tuple(boosters), tuple(scales))
    return replace(observations, model=model).with_windows(
        np.hstack([windows, number]), shift_ticks=observations.shift_ticks
    )
