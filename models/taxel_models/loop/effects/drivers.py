"""Drivers: features that weights multiply, and forms whose regressors are a shape times drivers."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxel.corrections import Shape, Weighted
from taxel.windows import Elapsed, ExtraFeature, HistoryFeature, Load, LoadAbove, Relaxation
from taxel_models.loop.basis import Floats, Shared
from taxel_models.loop.effects.effect import Candidate, Online
from taxel_models.loop.observations import Observations


@dataclass(frozen=True)
class Driver:
    """A feature that weights multiply, with its name in corrections.

    `extra` is None for a column of the window. `weight_name` is its own name, if it is empty.
    """

    name: str
    values: Floats
    extra: ExtraFeature | None = None
    weight_name: str = ""


def past(observations: Observations, feature: HistoryFeature, name: str, unit: str) -> Driver:
    """A history feature as a driver. Where the caller leaves it out, it is as after a long rest.

    What has the load itself in it, and does not end at 0, has its mean.
    """
    values = observations.history(feature)
    has_load = isinstance(feature, Load | LoadAbove) or (isinstance(feature, Relaxation) and feature.whole)
    default = float(values.mean()) if has_load else 0.0
    extra = ExtraFeature(name=name, unit=unit, default=default, history=feature, taken_by="effects")
    return Driver(name, values, extra)


def evenly_filled(observations: Observations, pieces: int) -> Floats:
    """(pieces + 1,) edges of the session's time, s, with as many rows in each piece: there may be gaps."""
    edges = np.quantile(observations.time_s, np.linspace(0.0, 1.0, pieces + 1))
    edges[0] = 0.0
    return np.unique(edges)


def elapsed(observations: Observations, edges: Floats) -> list[Driver]:
    """The session's time between edges, s: one driver for each piece of a piecewise linear function."""
    digits = 0 if np.diff(edges).min() >= 1.0 else 2
    drivers = []
    for start, end in pairwise(edges):
        span = Elapsed(start_s=float(start), end_s=float(end))
        first, last = f"{start:.{digits}f}", f"{end:.{digits}f}"
        driver = past(observations, span, f"elapsed[{first}:{last}s]", "s")
        drivers.append(replace(driver, weight_name=f"slope from {first} to {last} s"))
    return drivers


def given(observations: Observations, name: str, unit: str) -> Driver:
    """A recorded column as a driver."""
    return Driver(name, observations.covariates[name], given_extra(observations, name, unit))


def given_extra(observations: Observations, name: str, unit: str) -> ExtraFeature:
    """A recorded column as an extra. Users of the model give it; its default is the mean."""
    default = float(observations.covariates[name].mean())
    return ExtraFeature(name=name, unit=unit, default=default, taken_by="effects")


def _settles(driver: Driver) -> bool:
    """Whether a history feature returns to 0 at rest."""
    history = None if driver.extra is None else driver.extra.history
    return history is not None and not isinstance(history, Elapsed)


def shape_of(observations: Observations, shape: Shape) -> Floats | None:
    """(n, 21) the shape that multiplies a driver; None for 1."""
    if shape == "unit":
        return None
    return observations.signal if shape == "signal" else observations.log_impedance_slope


def weighted(
    observations: Observations,
    effect: str,
    form: str,
    shape: Shape,
    drivers: Sequence[Driver],
    *,
    centred: bool = True,
    rows: NDArray[np.bool_] | slice = slice(None),
    **others: Any,
) -> Candidate:
    """A form whose regressors are a shape times drivers, less the drivers' means.

    The mean of a history feature that settles is not taken out: at rest it must add nothing.

    Args:
        rows: (n,) those that the means are of; all by default.
    """
    values = np.column_stack([driver.values for driver in drivers])
    about = [centred and not _settles(driver) for driver in drivers]
    references = np.where(about, values[rows].mean(axis=0), 0.0)
    names = tuple(driver.name for driver in drivers)

    def online(weights: Floats) -> Online:
        term = Weighted(
            shape=shape,
            features=names,
            references=tuple(references.tolist()),
            weights=tuple(tuple(row) for row in weights.T.tolist()),
            rest=tuple(observations.rest.tolist()),
        )
        return Online((term,), tuple(driver.extra for driver in drivers if driver.extra is not None))

    others.setdefault("weight_names", tuple(driver.weight_name or driver.name for driver in drivers))
    return Candidate(
        effect,
        form,
        Shared(values - references, shape_of(observations, shape)),
        online=online,
        again=lambda other: weighted(
            other, effect, form, shape, drivers, centred=centred, rows=rows, **others
        ),
        **others,
    )
