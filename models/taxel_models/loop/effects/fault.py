"""Fault: a channel is dead, stuck or intermittent."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections import Substitute
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Left, Online
from taxel_models.loop.evidence import Evidence
from taxel_models.loop.moments import Fitting
from taxel_models.loop.planting import Planting

SHORTEST_RUN: Final = 25
"""Rows, 250 ms, of one value: longer than sample and hold, shorter than a broken contact."""

BY_CHANCE: Final = 1e-3
"""Runs so long that fewer than so many are expected in the recording, by how often values repeat."""

WHOLE: Final = 0.95
"""Share of the rows since the first run from which on a channel counts as stuck for good."""

Kind = Literal["stuck", "intermittent"]


@dataclass(frozen=True)
class Frozen:
    """A channel that repeats one value.

    Attributes:
        channel: its column.
        rows: (n,) where it does.
        value: the commonest of the values that it is stuck at, counts.
        kind: for good, or off and on.
    """

    channel: int
    rows: NDArray[np.bool_]
    value: float
    kind: Kind


class Fault(Effect):
    """The channel reads one value whatever happens, from some time on, or off and on."""

    name = "fault"
    looks_at_residual = True
    equation = "measured_c = v_c"
    source = "frozen channels and unconnected fingers in public logs"
    signature = "runs of exactly repeated values while the model's prediction moves"

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        found = frozen_channels(evidence.measured, evidence.segment)
        kinds: tuple[Kind, ...] = ("stuck", "intermittent")
        for kind in kinds:
            some = [one for one in found if one.kind == kind]
            if some:
                yield self._with(some, kind, left.residual)

    def _with(self, found: Sequence[Frozen], kind: Kind, residual: Floats) -> Candidate:
        values = np.zeros((*residual.shape, 1), np.float32)
        for one in found:
            values[one.rows, one.channel, 0] = residual[one.rows, one.channel]

        substitutes = tuple(Substitute(channel=CHANNELS[one.channel], value=one.value) for one in found)
        online = Online(substitutes if kind == "stuck" else ())
        names = ", ".join(CHANNELS[one.channel] for one in found)
        return Candidate(
            self.name,
            f"{kind}: {names}",
            Own(values),
            fitting=Fitting(fixed=True),
            settled={
                f"rows affected, {CHANNELS[one.channel]}": (float(one.rows.mean()), "share")
                for one in found
            },
            online=lambda _: online,
            certain=True,
            again=lambda _: self._with(found, kind, residual),
        )

    @override
    def plant(self, planting: Planting) -> None:
        channel = int(planting.random.integers(len(CHANNELS)))
        kind = str(planting.random.choice(["dead", "stuck", "intermittent"]))
        counts = planting.recording.channels.copy()
        rows = np.zeros(len(counts), bool)
        if kind == "intermittent":
            for _ in range(12):
                start = int(planting.random.integers(len(counts)))
                rows[start : start + int(planting.random.integers(60, len(counts) // 60 + 61))] = True
        else:
            rows[:] = True
        value = (
            0.0 if kind == "dead" else float(counts[int(planting.random.integers(len(counts))), channel])
        )
        counts[rows, channel] = value
        planting.replace_channels(
            replace(planting.recording, channels=counts), channel=CHANNELS[channel], kind=kind
        )


def frozen_channels(measured: Floats, segment: NDArray[np.int64]) -> list[Frozen]:
    """Channels that repeat a value for longer than chance explains."""
    found = []
    for channel in range(measured.shape[1]):
        rows = _runs(measured[:, channel], segment)
        if not rows.any():
            continue
        values, counts = np.unique(measured[rows, channel], return_counts=True)
        value = float(values[counts.argmax()])
        since = int(np.argmax(rows))
        stuck = rows[since:].mean() > WHOLE and (measured[since:, channel] == value).mean() > WHOLE
        found.append(Frozen(channel, rows, value, "stuck" if stuck else "intermittent"))
    return found


def _runs(values: Floats, segment: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(n,) rows in runs of one value that are too long for how often values repeat elsewhere."""
    starts = np.flatnonzero((np.diff(values, prepend=np.nan) != 0) | (np.diff(segment, prepend=-1) != 0))
    lengths = np.diff(starts, append=len(values))
    short = lengths[lengths < SHORTEST_RUN]
    repeats = 1.0 - len(short) / short.sum() if short.sum() > SHORTEST_RUN else 0.5
    needed = np.log(BY_CHANCE / len(values)) / np.log(np.clip(repeats, 1e-3, 0.9999))
    return np.repeat(lengths >= max(SHORTEST_RUN, needed), lengths)
