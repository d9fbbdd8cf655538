"""Proposals: for two causes that cannot be told apart, the shortest protocol that most likely does it."""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from taxel.windows.history import TOUCH_N
from taxel_models.loop.attribution import Named
from taxel_models.loop.effects.temperature import TDC
from taxel_models.loop.findings import NextRecording
from taxel_models.loop.next_recording.fitted import Fitted, fitted_in_place
from taxel_models.loop.next_recording.rehearsal import SIMULATED, Stage, rehearse
from taxel_models.loop.observations import Observations
from taxel_models.loop.pipeline import LoopResult
from taxel_models.loop.status import StatusCallback, silent
from taxel_models.recordings.kinds import are_kinds
from taxel_models.twin.protocol import RecordingProtocol
from taxel_models.twin.protocol_menu import in_turn, menu
from taxel_models.twin.temperature import on_for

MOST_PAIRS: Final = 3
"""Pairs of causes that are looked at, in the order in which they were named: each takes some seconds."""

FORCE_N: Final = (0.5, 8.0)
"""Limits of the force that is proposed."""

FEWEST_RIGHT: Final = 8
"""Of the ten decisions on simulated recordings of a protocol, for it to be proposed."""

_FORCE_QUANTILE: Final = 0.9
_MOST_KINDS: Final = 12
"""Values of a column that a protocol takes in turn."""


def propose(result: LoopResult, *, progress: StatusCallback = silent) -> LoopResult:
    """The result with what to record next in its findings.

    Args:
        progress: is told what is looked at.
    """
    attribution = result.attribution
    stage = Stage(
        attribution.observations,
        result.blocks,
        attribution.residual,
        result.reference,
        result.constants,
    )
    proposals: list[NextRecording] = []
    for named, name in list(_pairs(attribution.named))[:MOST_PAIRS]:
        progress(f"what would tell {named.name} from {name}")
        other = fitted_in_place(
            result.observations, result.blocks, attribution, named, name, stage.reference, stage.constants
        )
        if other is not None:
            proposals.append(_proposal(stage, Fitted.of(named), other, len(proposals) + 1))
    findings = result.findings.model_copy(update={"next_recordings": tuple(proposals)})
    return replace(result, findings=findings)


def _pairs(named: tuple[Named, ...]) -> Iterator[tuple[Named, str]]:
    """Each named effect with those that could stand for it; a pair comes once."""
    told = set()
    for one in named:
        for name in one.confounded_with:
            pair = frozenset({one.name, name})
            if pair not in told:
                told.add(pair)
                yield one, name


def _proposal(stage: Stage, first: Fitted, second: Fitted, number: int) -> NextRecording:
    best: tuple[RecordingProtocol, int] | None = None
    known = first.foretells and second.foretells
    for protocol in _protocols(stage.observations, first, second) if known else []:
        must_exceed = FEWEST_RIGHT - 1 if best is None else best[1]
        found = rehearse(stage, protocol, (first, second), must_exceed=must_exceed)
        if found is not None:
            best = protocol, found
        if best is not None and best[1] == SIMULATED:
            break
    causes = (first.name, second.name)
    if best is None:
        return NextRecording(causes=causes, can_be_simulated=known)
    protocol, right = best
    names = "-".join(re.sub("[^A-Za-z0-9]+", "-", cause) for cause in causes)
    return NextRecording(
        causes=causes,
        protocol=protocol,
        file=f"next-{number}-{names}.json",
        duration_s=protocol.duration_s,
        simulated=SIMULATED,
        right=right,
    )


def _protocols(observations: Observations, *causes: Fitted) -> list[RecordingProtocol]:
    """The menu for these causes, the shortest first, with a finger as warm as in the recordings at hand."""
    touched = observations.pressed[observations.pressed > TOUCH_N]
    usual = float(np.quantile(touched, _FORCE_QUANTILE)) if len(touched) else FORCE_N[0]
    force = round(float(np.clip(usual, *FORCE_N)), 1)
    columns = [name.partition(":")[2] for name in (cause.name for cause in causes) if ":" in name]
    protocols = [] if columns else list(menu(force))
    for column in columns:
        values = np.unique(observations.covariates[column])
        if are_kinds(values):
            values = values[:: -(-len(values) // _MOST_KINDS)]
        else:
            values = np.quantile(observations.covariates[column], np.linspace(0.05, 0.95, 5))
        protocols.append(in_turn(force, column, values.tolist()))
    tdc = observations.covariates.get(TDC)
    if tdc is not None:
        warm_s = float(round(on_for(float(tdc.mean()))))
        protocols = [one.model_copy(update={"on_for_s": warm_s}) for one in protocols]
    return sorted(protocols, key=lambda protocol: protocol.duration_s)
