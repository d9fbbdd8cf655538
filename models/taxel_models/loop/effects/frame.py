"""Frame: the recorded forces or positions are in a turned or shifted frame."""

from collections.abc import Iterable
from functools import partial
from typing import Final

import numpy as np
from typing_extensions import override

from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Online, Remaining
from taxel_models.loop.effects.rigid_motion import after, fit_motion, turn_of
from taxel_models.loop.observations import Observations
from taxel_models.model import predict_all

MOST_ROWS: Final = 12_000
"""The motion's change is predicted at so many rows at most: two for each bin."""

EVERY: Final = 5
"""Rows from one such row to the next."""

NAMES: Final = {
    "force": "forces turned",
    "position": "positions turned",
    "shift": "positions shifted",
    "both": "both turned alike",
}


class Frame(Effect):
    """A rigid motion between the recorded frame and the model's frame. All channels share it."""

    name = "frame"
    looks_at_residual = True
    is_costly = True
    equation = "measured = model(R x + t, Q F)"
    source = "rigid motion; Gauss-Newton on finite differences of the model"
    signature = "turning or shifting the inputs explains all channels with three common parameters"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        found = fit_motion(observations, remaining)
        if found is None:
            return
        kind, vector = found
        count = min(-(-len(observations) // EVERY), MOST_ROWS)
        rows = np.linspace(0, len(observations) - 1, count).astype(np.int64)
        turned = turn_of(kind, vector).turn(observations.windows[rows], observations.manifest.spec)
        change = predict_all(observations.model.predict, turned) - observations.predicted[rows]
        yield Candidate(
            self.name,
            NAMES[kind],
            Own(change[:, :, None].astype(np.float32), rows),
            fitting=Fitting(fixed=True, motion=3, choices=len(NAMES)),
            form_parameters=_form_parameters(kind, vector),
            online=partial(_online, kind, vector),
            moved=partial(_moved, kind, vector),
        )


def _form_parameters(kind: str, vector: Floats) -> dict[str, tuple[float, str]]:
    """The motion's parameters, for a report."""
    if kind == "shift":
        named = dict(zip("xyz", vector * 1e3, strict=True))
        return {name: (float(value), "mm") for name, value in named.items()}
    named = dict(zip("xyz", np.degrees(vector), strict=True))
    angle = float(np.degrees(np.linalg.norm(vector)))
    return {"angle": (angle, "deg"), **{name: (float(value), "deg") for name, value in named.items()}}


def _online(kind: str, vector: Floats, weights: Floats) -> Online:
    del weights
    return Online(frame=turn_of(kind, vector))


def _moved(kind: str, vector: Floats, observations: Observations) -> Observations:
    """The observations with turned windows. Windows that are turned already are turned further."""
    turn = turn_of(kind, vector)
    windows = turn.turn(observations.windows, observations.manifest.spec)
    whole = turn if observations.turn is None else after(turn, observations.turn)
    return observations.with_windows(windows, turn=whole, shift_ticks=observations.shift_ticks)
