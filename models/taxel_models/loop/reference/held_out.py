"""The reference: a model's own held-out residual, which says what the model gets wrong anyway.

Training holds out few contacts, and what few contacts leave open hides much of what another one shows.
So stand-ins predict all contacts, each by trees that never saw it. What the model itself shows on all of
them, also on those that it was fitted to, counts beside that.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from taxel.errors import RecordingError
from taxel.held_out_residual import CorrelatedResidual, HeldOutResidual, OwnStructure
from taxel_models.loop.blocks import cut
from taxel_models.loop.channel_history import usual_changes
from taxel_models.loop.effects.interference import own_waves
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.contact_offset import ContactOffset
from taxel_models.loop.inference.kinds import figures, of_figures, trained_kinds
from taxel_models.loop.inference.whitening import NoiseShape
from taxel_models.loop.observations import FEWEST_CONTACTS, Observations, gather
from taxel_models.loop.reference.correlated import correlated_residual, correlated_structure
from taxel_models.loop.reference.gain_limit import times_for_few
from taxel_models.loop.reference.one_kind import residual_of_one_kind
from taxel_models.loop.reference.own_structure import KEPT, MEAN, OPEN, own_residual
from taxel_models.loop.reference.stand_ins import without_their_contact, without_their_kind
from taxel_models.loop.status import StatusCallback, silent
from taxel_models.model import Model
from taxel_models.recordings import Recording

MOST_ROWS: Final = 60_000
"""10 min: each contact takes time, and enough are known by then."""

FEWEST_ROWS: Final = 2000
"""Of all recordings together, 20 s: fewer blocks leave open whether the model lacks anything at all."""


def held_out_residual(
    model: Model,
    recordings: Sequence[Recording],
    fitted: Sequence[Recording] = (),
    constants: Constants = DECLARED,
    progress: StatusCallback = silent,
) -> HeldOutResidual | None:
    """Of a model and the recordings that its training held out; None where they are too short.

    Args:
        fitted: what the model was fitted to, if that is kept: stand-ins predict it.
        constants: of the inference.
        progress: is told what is looked at.
    """
    try:
        own, observations = _own_and_stand_ins(model, recordings, fitted, progress)
        if len(observations) < FEWEST_ROWS:
            return None
        blocks = cut(observations, seed=0, held_out=KEPT)
        correlated = correlated_residual(observations, blocks, constants, progress)
        if correlated is not None and observations is not own:
            beside = correlated_structure(own, blocks, correlated, constants)
            correlated = correlated.model_copy(update={"structure": _larger(correlated.structure, beside)})
        found = _by_kind(observations, observations.kind_columns, correlated, constants, progress)
        if observations is not own:
            shown = own_residual(own, constants, progress, MEAN, NoiseShape.kept(found)).structure
            found = found.model_copy(update={"structure": _larger(found.structure, shown)})
        new = {}
        for column in sorted(found.one_kind.keys() & trained_kinds(model.manifest).keys()):
            stand_ins = without_their_kind(observations, column)
            found_of_new = _by_kind(
                stand_ins, [column], None, constants, lambda one: progress(f"new {one}")
            )
            # No kind that training had is new to the model.
            one_kind = {
                name: kind.model_copy(update={"kinds": {}}) for name, kind in found_of_new.one_kind.items()
            }
            new[column] = found_of_new.model_copy(update={"one_kind": one_kind})
    except RecordingError:
        return None
    usual = tuple(usual_changes(observations, blocks).tolist())
    return found.model_copy(
        update={
            "sensitivity_change": usual,
            "correlated": correlated,
            "new_kinds": new,
            "waves": own_waves(observations, np.ones(len(observations), np.bool_)),
        }
    )


def _own_and_stand_ins(
    model: Model, recordings: Sequence[Recording], fitted: Sequence[Recording], progress: StatusCallback
) -> tuple[Observations, Observations]:
    """The same rows, predicted by the model and by stand-ins; both by the model where there are none.

    Of contacts that make more than `MOST_ROWS` rows, some are drawn at random, beside those held out.
    """
    own = gather(model, [*recordings, *fitted])
    if fitted:
        progress("every contact by trees that never saw it")
    stand_ins = without_their_contact(own) if fitted else None
    if stand_ins is None:
        held_out = gather(model, recordings) if fitted else own
        return held_out, held_out
    contacts, rows = np.unique(own.contact, return_counts=True)
    fitted_to = ~np.isin(contacts, own.contact[: sum(map(len, own.rows[: len(recordings)]))])
    order = np.random.default_rng(0).permutation(len(contacts))
    order = order[np.argsort(fitted_to[order], kind="stable")]
    drawn = contacts[order[np.cumsum(rows[order]) - rows[order] < MOST_ROWS]]
    kept = np.isin(own.contact, drawn)
    return own.kept(kept), stand_ins.kept(kept)


def _larger(
    found: Mapping[str, OwnStructure], shown: Mapping[str, OwnStructure]
) -> dict[str, OwnStructure]:
    """What effects explain of stand-ins' residual, or of the model's own where that is more.

    Stand-ins lack what only this model gets wrong, such as a bend that a small network cannot follow or a
    channel whose training stopped early. It gets that wrong on what it was fitted to as well.
    """
    larger = {
        name: np.maximum(figures(own), figures(shown[name])) if name in shown else figures(own)
        for name, own in found.items()
    }
    return of_figures(larger, [found, shown])


def _by_kind(
    observations: Observations,
    columns: Sequence[str],
    correlated: CorrelatedResidual | None,
    constants: Constants,
    progress: StatusCallback,
) -> HeldOutResidual:
    """Of all rows together, and of one kind of each column that names enough of them."""
    found = own_residual(observations, constants, progress)
    found = found.model_copy(update={"structure": _with_known_scatter(found.structure, observations)})
    shape = NoiseShape.kept(found)
    kinds = {
        column: residual_of_one_kind(observations, column, shape, correlated, constants, progress)
        for column in columns
    }
    return found.model_copy(update={"one_kind": {column: own for column, own in kinds.items() if own}})


def _with_known_scatter(
    structure: Mapping[str, OwnStructure], observations: Observations
) -> dict[str, OwnStructure]:
    """The structure, with what is usual of offsets of contacts: more, the fewer contacts tell it."""
    known = dict(structure)
    own = known.pop(ContactOffset.name, None)
    contacts = len(np.unique(observations.contact))
    if own is not None and contacts >= FEWEST_CONTACTS:
        # Their mean takes one degree of freedom.
        more = times_for_few(contacts - 1, OPEN)
        known[ContactOffset.name] = own.model_copy(
            update={
                "log_evidence": tuple(more * odds for odds in own.log_evidence),
                "gain": tuple(more * gain for gain in own.gain),
            }
        )
    return known
