"""A residual model: predicts what no named effect explains. It has no name and no cause.

It is a ridge regression on random features (Rahimi and Recht 2007) of what serving can compute: the base
model's prediction, the window, memories of the force, and the recorded columns. It takes no calibration: an
offset from a calibration is an effect, and both are added. Inputs, width and each channel's ridge are
chosen on held-out folds. A channel has it only if its error falls there.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from taxel.channels import CHANNELS
from taxel.corrections import AppliedEffect, RandomFeatures
from taxel.windows import ExtraFeature, HistoryFeature, Play, Rate, Relaxation, Speed
from taxel.windows.history import Followed
from taxel_models.loop.attribution import Attribution
from taxel_models.loop.basis import Floats, Rows
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.correction import NewEffects, feature_columns
from taxel_models.loop.effects.covariate import Covariate, kind_extra
from taxel_models.loop.effects.drivers import given_extra
from taxel_models.loop.effects.temperature import TDC, Temperature
from taxel_models.loop.findings import ChannelGain, FoundResidualModel
from taxel_models.loop.observations import Observations
from taxel_models.recordings.kinds import NOT_COVARIATES, are_kinds

NAME: Final = "residual_model"
COSINES: Final = 512
COSINES_TRIED: Final = 256
"""While inputs are chosen."""

LIMIT: Final = 3.0
"""Of the z-scored inputs: beyond what was recorded, nothing is extrapolated."""

WIDTHS: Final = (1.0, 1.5, 2.0)
"""Of the kernel, over the distance that one group of inputs makes; tried one by one."""

RIDGES: Final = tuple(np.geomspace(1e-3, 3.0, 8).tolist())
"""Over the mean square of a random feature; tried one by one."""

LEAST_T: Final = 2.0
"""Of a channel's gain over held-out blocks."""

MOST_ROWS: Final = 8_000
"""More rows are thinned out: neighbouring rows tell nearly the same."""

MEMORIES_S: Final = (0.1, 1.0, 10.0)
FOLLOWED: Final[tuple[Followed, ...]] = ("force", "fx", "fy", "fz")
PLAYS_N: Final = (0.3, 1.0, 3.0)
_DIGITS: Final = 6
"""Significant digits of what is fitted: a manifest holds it as text."""


@dataclass(frozen=True)
class ResidualModel:
    """A fitted residual model.

    Attributes:
        effect: its online form.
        extras: the features that it needs beside the window.
        gain: (21,) fall of each channel's mean absolute error over held-out blocks, counts.
        error: (21,) the standard error of that, counts.
        has: (21,) which channels have it.
    """

    effect: AppliedEffect
    extras: tuple[ExtraFeature, ...]
    gain: Floats
    error: Floats
    has: NDArray[np.bool_]

    def added_to(self, new: NewEffects) -> NewEffects:
        """The corrected model with the residual model behind its effects."""
        extras = {extra.name: extra for extra in (*new.extras, *self.extras)}
        return NewEffects((*new.effects, self.effect), tuple(extras.values()))

    def found(
        self, observations: Observations, blocks: Blocks, without: Floats, after: Floats
    ) -> FoundResidualModel:
        """For the report.

        Args:
            without: (n, 21) what the corrected model gives without it, counts.
            after: (n, 21) likewise with it.
        """
        rows, std = blocks.evaluation, np.array(observations.manifest.normalisation.output_std)
        measured = observations.measured[rows]
        fall = np.abs(measured - without[rows]) - np.abs(measured - after[rows])
        evaluation = fall.mean(axis=0) / std
        return FoundResidualModel(
            about=self.effect.about,
            channels=tuple(
                ChannelGain(channel=name, folds=folds, error=error, evaluation=on_evaluation)
                for name, has, folds, error, on_evaluation in zip(
                    CHANNELS, self.has, self.gain / std, self.error / std, evaluation, strict=True
                )
                if has
            ),
            gain=float(evaluation.mean()),
            needs=tuple(extra.name for extra in self.extras),
        )


def residual_model(
    observations: Observations,
    attribution: Attribution,
    blocks: Blocks,
    left: Floats,
    *,
    exclude: Collection[str] = (),
    seed: int = 0,
) -> ResidualModel | None:
    """Fit what is left on the fit part; None if no channel's error falls on held-out folds.

    Groups of inputs are added one by one to the base's prediction while the error on held-out folds
    falls by more than its standard error over blocks.

    Args:
        observations: before any input was moved.
        left: (n, 21) measured less corrected, counts.
        exclude: effects whose columns it must not take either, such as `covariate:trial`.
        seed: of the random features.
    """
    extras = _extras(observations, exclude)
    window = observations.manifest.spec.unshifted.features
    every = [extra for group in extras.values() for extra in group]
    columns = feature_columns(observations, attribution.observations, every)
    groups: dict[str, tuple[str, ...]] = {"window": tuple(window)}
    groups |= {name: tuple(extra.name for extra in group) for name, group in extras.items()}
    data = _Data.of(attribution.observations.base, columns, left, blocks, observations)
    chosen: list[tuple[str, ...]] = []
    best = _Fit.of(data, chosen, WIDTHS[1], COSINES_TRIED, seed)
    while len(chosen) < len(groups):
        remaining = [group for group in groups.values() if group not in chosen]
        tried = {
            group: _Fit.of(data, [*chosen, group], WIDTHS[1], COSINES_TRIED, seed) for group in remaining
        }
        group = max(tried, key=lambda name: tried[name].falls.mean())
        if not _rises(tried[group].falls.mean(axis=1) - best.falls.mean(axis=1)):
            break
        best = tried[group]
        chosen.append(group)
    best = max(
        (_Fit.of(data, chosen, width, COSINES, seed) for width in WIDTHS), key=lambda fit: fit.falls.mean()
    )
    if not best.has.any():
        return None
    term = best.term(data, chosen)
    effect = AppliedEffect(
        name=NAME,
        about="what no cause explains, as a smooth function of what is known while serving; it has no name",
        channels=tuple(name for name, has in zip(CHANNELS, best.has, strict=True) if has),
        terms=(term,),
    )
    taken = tuple(extra for extra in every if extra.name in term.features)
    gain, error = best.falls.mean(axis=0) * data.scale, _error(best.falls) * data.scale
    return ResidualModel(effect, taken, gain, error, best.has)


def _extras(observations: Observations, exclude: Collection[str]) -> dict[str, tuple[ExtraFeature, ...]]:
    """What serving computes or is given beside the window, in groups."""
    memories: list[tuple[str, str, HistoryFeature]] = [
        *(
            (f"memory[{tau:g}s].{of}", "N", Relaxation(of=of, time_constant_s=tau))
            for tau in MEMORIES_S
            for of in FOLLOWED
        ),
        *((f"memory.play[{width:g}N].force", "N", Play(of="force", width_n=width)) for width in PLAYS_N),
        *((f"memory.rate.{of}", "N/s", Rate(of=of)) for of in FOLLOWED),
        ("memory.speed", "m/s", Speed()),
    ]
    groups = {
        "memories": tuple(
            ExtraFeature(name=name, unit=unit, history=history, taken_by="effects")
            for name, unit, history in memories
        )
    }
    for column, values in observations.covariates.items():
        if column == TDC:
            excluded = Temperature.name in exclude
        else:
            excluded = column in NOT_COVARIATES or Covariate(column).label in exclude
        if excluded:
            continue
        kinds = np.unique(values)
        if column != TDC and are_kinds(kinds):
            groups[column] = tuple(kind_extra(column, values, kind) for kind in kinds)
        else:
            groups[column] = (given_extra(observations, column, ""),)
    return groups


@dataclass(frozen=True)
class _Data:
    """Rows of the fit part, in the order of their blocks.

    Attributes:
        inputs: z-scores within `LIMIT`, by name, each (m,).
        moments: mean and SD of each.
        target: (m, 21) over `scale`.
        scale: (21,) counts.
        counted: (m,) how much each row counts.
        fold: (m,).
        starts: first row of each block.
    """

    inputs: dict[str, Floats]
    moments: dict[str, tuple[float, float]]
    target: Floats
    scale: Floats
    counted: Floats
    fold: Rows
    starts: Rows

    @classmethod
    def of(
        cls,
        base: Floats,
        columns: Mapping[str, Floats],
        left: Floats,
        blocks: Blocks,
        observations: Observations,
    ) -> Self:
        rows = np.flatnonzero(blocks.fit)
        rows = rows[:: -(-len(rows) // MOST_ROWS)]
        block = blocks.of_row[rows]
        known = {**dict(zip(CHANNELS, base.T, strict=True)), **columns}
        moments = {}
        for name, values in known.items():
            mean, std = _rounded(np.array([values[rows].mean(), values[rows].std()])).tolist()
            # A column that stays the same is no input, whatever its rounding errors are.
            moments[name] = (mean, std if std > 1e-6 * abs(mean) else 1.0)
        inputs = {
            name: np.clip((values[rows] - moments[name][0]) / moments[name][1], -LIMIT, LIMIT)
            for name, values in known.items()
        }
        scale = np.array(observations.manifest.normalisation.output_std)
        target = left[rows] / scale
        starts = np.flatnonzero(np.diff(block, prepend=-1))
        return cls(inputs, moments, target, scale, _counted(target, starts), blocks.fold[block], starts)


@dataclass(frozen=True)
class _Fit:
    """Random features of some inputs, with each channel's best ridge.

    Attributes:
        falls: (blocks, 21) fall of the mean absolute error of each held-out block, over the scale.
        projection: (k, cosines).
        phases: (cosines,).
        weights: (cosines, 21) over the scale.
        constants: (21,) over the scale.
    """

    falls: Floats
    projection: Floats
    phases: Floats
    weights: Floats
    constants: Floats

    @property
    def has(self) -> NDArray[np.bool_]:
        """(21,) channels whose error falls by more than chance."""
        return np.asarray(self.falls.mean(axis=0) > LEAST_T * _error(self.falls))

    @classmethod
    def of(
        cls, data: _Data, chosen: Sequence[Sequence[str]], width: float, cosines: int, seed: int
    ) -> Self:
        groups = [CHANNELS, *chosen]
        # Each group makes the same distance between two rows, however many inputs it has.
        sizes = np.array([len(group) for group in groups for _ in group], dtype=np.float64)
        random = np.random.default_rng(seed)
        projection = _rounded(random.normal(size=(len(sizes), cosines)) / (width * np.sqrt(sizes))[:, None])
        phases = _rounded(random.uniform(0.0, 2.0 * np.pi, cosines))
        z = np.column_stack([data.inputs[name] for group in groups for name in group])
        features = np.cos(z @ projection + phases)
        sums = {fold: _Sums.of(data, features, data.fold == fold) for fold in np.unique(data.fold).tolist()}
        whole = _Sums._make(sum(parts) for parts in zip(*sums.values(), strict=True))
        predicted = np.empty((len(RIDGES), *data.target.shape))
        for fold, held in sums.items():
            rows = data.fold == fold
            weights, constants = whole.less(held).ridges()
            predicted[:, rows] = features[rows] @ weights + constants[:, None]
        falls = np.abs(data.target) - np.abs(data.target - predicted)
        rows_of_block = np.diff(data.starts, append=len(z))
        falls = np.add.reduceat(falls, data.starts, axis=1) / rows_of_block[:, None]
        best = falls.mean(axis=1).argmax(axis=0)
        weights, constants = whole.ridges()
        channels = np.arange(len(CHANNELS))
        return cls(
            falls[best, :, channels].T,
            projection,
            phases,
            weights[best, :, channels].T,
            constants[best, channels],
        )

    def term(self, data: _Data, chosen: Sequence[Sequence[str]]) -> RandomFeatures:
        """The online form, for the channels that have it."""
        names = [name for group in chosen for name in group]
        moments = [data.moments[name] for name in (*CHANNELS, *names)]
        weights = _rounded(self.weights * data.scale * self.has)
        constants = _rounded(self.constants * data.scale * self.has)
        return RandomFeatures(
            features=tuple(names),
            means=tuple(mean for mean, _ in moments),
            scales=tuple(std for _, std in moments),
            limit=LIMIT,
            projection=tuple(map(tuple, self.projection.tolist())),
            phases=tuple(self.phases.tolist()),
            weights=tuple(map(tuple, weights.tolist())),
            constants=tuple(constants.tolist()),
        )


class _Sums(NamedTuple):
    """What ridge regressions need of some rows: of f features, targets, and how much each row counts."""

    counted: Floats
    features: Floats
    target: Floats
    gram: Floats
    cross: Floats

    @classmethod
    def of(cls, data: _Data, features: Floats, rows: NDArray[np.bool_]) -> Self:
        counted, target, some = data.counted[rows], data.target[rows], features[rows]
        weighted = (some * counted[:, None]).T
        return cls(
            np.array(counted.sum()),
            weighted.sum(axis=1),
            counted @ target,
            weighted @ some,
            weighted @ target,
        )

    def less(self, other: "_Sums") -> "_Sums":
        """Of the rows that are not among those of the other."""
        return _Sums._make(mine - its for mine, its in zip(self, other, strict=True))

    def ridges(self) -> tuple[Floats, Floats]:
        """Weights (ridges, f, 21) and constants (ridges, 21); the constants are not shrunk."""
        mean, level = self.features / self.counted, self.target / self.counted
        values, vectors = linalg.eigh(self.gram / self.counted - np.outer(mean, mean))
        cross = vectors.T @ (self.cross / self.counted - np.outer(mean, level))
        weights = np.stack([vectors @ (cross / (values + ridge)[:, None]) for ridge in RIDGES])
        return weights, level - mean @ weights


def _counted(target: Floats, starts: Rows) -> Floats:
    """(m,) how much each row counts: less in blocks that err more than the median block does."""
    rows = np.diff(starts, append=len(target))
    size = np.add.reduceat(np.abs(target).mean(axis=1), starts) / rows
    return np.repeat(np.minimum(1.0, np.median(size) / np.maximum(size, 1e-12)), rows)


def _error(falls: Floats) -> Floats:
    """Standard error of the mean over blocks."""
    return np.asarray(falls.std(axis=0, ddof=1) / np.sqrt(len(falls)))


def _rises(falls: Floats) -> bool:
    """Whether (blocks,) are above 0 by more than their standard error."""
    return bool(falls.mean() > _error(falls))


def _rounded(values: Floats) -> Floats:
    """With so many significant digits as a manifest holds."""
    size = 10.0 ** (_DIGITS - 1 - np.floor(np.log10(np.maximum(np.abs(values), 1e-200))))
    return np.asarray(np.where(values == 0.0, 0.0, np.rint(values * size) / size))
