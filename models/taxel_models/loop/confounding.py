"""Confounding in the recordings: what runs along with time, order, phase or a column, before any fit.

A cause that depends on one of two such quantities cannot be told from a cause that depends on the other.
The residual is not used.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.windows.history import TICK_S, TOUCH_N, Friction, HistoryFeature, Starts, Warmth
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.temperature import TDC
from taxel_models.loop.findings import RunsAlong
from taxel_models.loop.observations import Observations
from taxel_models.recordings.kinds import NOT_COVARIATES, are_kinds

CELLS: Final = 10
"""A quantity is known by which tenth of its rows a row is in."""

FEWEST: Final = 8
"""Contacts, for a share that means something."""

TIME, ORDER, PHASE, CONSTANT = "time", "order of contacts", "phase within a contact", "a constant"

_WIDTH: Final = 0.25
"""Of the friction that is looked at, over the force that 95 % of the rows stay below."""

_WARMING_S: Final = 3.0
"""Of the warmth that is looked at."""


class _Quantity(NamedTuple):
    """At the touched rows: its values (m, k), and the cell (m,) that each row is in."""

    values: Floats
    cells: NDArray[np.int64]


def confounding(observations: Observations) -> tuple[RunsAlong, ...]:
    """The share of each quantity's variance that another one predicts, the largest first.

    The other ones are time, the order of contacts, the phase within a contact, and every further column.
    The share is epsilon squared (Kelley 1935) over cells of the other quantity; only rows in
    contact count, and contacts are taken as independent.

    Of what friction and warming by contact would do, also the share of the squares that a constant has:
    where the force hardly falls, or the skin stays as warm, they would look like an offset.
    """
    touched = observations.pressed > TOUCH_N
    contact, phase = _contacts(observations, touched)
    contacts = len(np.unique(contact[touched]))
    if contacts < FEWEST:
        return ()
    columns = {
        name: values for name, values in observations.covariates.items() if name not in NOT_COVARIATES
    }
    order = contact.astype(np.float64)
    given = _amounts({TIME: observations.time_s, ORDER: order, PHASE: phase}, touched)
    given |= {name: _column(values[touched]) for name, values in columns.items()}
    others = {"force": observations.pressed}
    if TDC in observations.covariates:
        others["temperature"] = observations.covariates[TDC]
    seen = {**given, **_amounts(others, touched)}
    seen["place"] = _Quantity(observations.position[touched], np.zeros(int(touched.sum()), np.int64))
    found = []
    for name, quantity in seen.items():
        for along, other in given.items():
            # Contacts come one after another, so time and their order are nearly the same.
            if name != along and {name, along} != {TIME, ORDER}:
                share = _predicted_share(quantity.values, other.cells, contacts)
                found.append(RunsAlong(quantity=name, along=along, share=share))
    found += _mostly_constant(observations)
    return tuple(sorted(found, key=lambda one: -one.share))


def _mostly_constant(observations: Observations) -> list[RunsAlong]:
    width = _WIDTH * float(np.quantile(observations.pressed, 0.95))
    start: Starts = "rest" if observations.starts_pressed else "settled"
    features: dict[str, HistoryFeature] = {
        "friction": Friction(of="force", width_n=width),
        "warming by contact": Warmth(of="force", warming_s=_WARMING_S, cooling_s=_WARMING_S, starts=start),
    }
    found = []
    for name, feature in features.items():
        values = observations.history(feature)
        share = float(values.mean() ** 2 / max((values**2).mean(), 1e-12))
        found.append(RunsAlong(quantity=name, along=CONSTANT, share=share))
    return found


def _contacts(observations: Observations, touched: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Floats]:
    """(n,) number of the contact, and (n,) s since it began; the free air after it belongs to it."""
    before = np.concatenate([[False], touched[:-1]])
    new_segment = np.diff(observations.segment, prepend=-1) != 0
    begins = new_segment | (touched & ~before)
    starts = np.flatnonzero(begins)
    number = np.cumsum(begins) - 1
    return number, (np.arange(len(touched)) - starts[number]) * TICK_S


def _amounts(columns: Mapping[str, Floats], touched: NDArray[np.bool_]) -> dict[str, _Quantity]:
    return {name: _amount(values[touched]) for name, values in columns.items()}


def _column(values: Floats) -> _Quantity:
    kinds, cells = np.unique(values, return_inverse=True)
    return _Quantity(np.eye(len(kinds))[cells], cells) if are_kinds(kinds) else _amount(values)


def _amount(values: Floats) -> _Quantity:
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, CELLS + 1)[1:-1]))
    return _Quantity(values[:, None], np.searchsorted(edges, values, side="right"))


def _predicted_share(values: Floats, cells: NDArray[np.int64], contacts: int) -> float:
    """The share of the variance (m, k) between cells (m,), less what chance gives so many contacts."""
    about = values - values.mean(axis=0)
    total = float((about**2).sum())
    counts = np.bincount(cells)
    if total <= 0:
        return 0.0
    sums = np.stack([np.bincount(cells, column) for column in about.T], axis=1)
    between = float((sums[counts > 0] ** 2 / counts[counts > 0, None]).sum())
    used = int((counts > 0).sum())
    left = (1.0 - between / total) * (contacts - 1) / max(contacts - used, 1)
    return max(0.0, 1.0 - left)
