"""Fault: a channel is dead, stuck or intermittent."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections import Substitute
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Left, Online
from taxel_models.loop.evidence import Evidence
from taxel_models.loop.frozen import Frozen, Kind, frozen_channels
from taxel_models.loop.moments import Fitting
from taxel_models.loop.planting import Planting


class Fault(Effect):
    """The channel reads one value whatever happens, from some time on, or off and on."""

    name = "fault"
    looks_at_residual = True
    equation = "measured_c = v_c"
    source = "frozen channels and unconnected fingers in public logs"
    signature = (
        "a value repeated for longer than chance allows, got to by a jump or while the prediction moves"
    )

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        found = frozen_channels(evidence.measured, evidence.predicted, evidence.segment)
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
