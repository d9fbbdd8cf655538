"""The pipeline of the loop: from a model and recordings to findings and a correction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.corrections import Parameter
from taxel.held_out_residual import HeldOutResidual
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.loop.attribution import Attribution
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import FOLDS, Blocks, cut
from taxel_models.loop.channel_history import ReadingChange, SensitivityChange, changed_channels
from taxel_models.loop.confounding import confounding
from taxel_models.loop.correction import NewEffects, corrected, served_windows
from taxel_models.loop.effects.fault import Fault, is_crossed
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.evaluation_part import found_effects, paired_test
from taxel_models.loop.findings import Findings, FoundResidualModel, NewKinds
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.kinds import new_kinds, of_its_kinds
from taxel_models.loop.inference.selection import JointSelection
from taxel_models.loop.inference.stability import on_halves
from taxel_models.loop.intervals import parameters
from taxel_models.loop.noise import NoiseFloor
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.residual_correlation import autocorrelations, cross_correlations
from taxel_models.loop.residual_diagnostics import diagnose_residual
from taxel_models.loop.residual_model import residual_model
from taxel_models.loop.resting import check_scale
from taxel_models.loop.status import StatusCallback, silent
from taxel_models.model import Model
from taxel_models.recordings import Recording
from taxel_models.recordings.findings import check_units, recording_findings


@dataclass(frozen=True)
class LoopSettings:
    """Settings of the loop.

    Attributes:
        seed: the seed of the split.
        held_out: the share of the blocks in the evaluation part.
        hold_out_by: a covariate whose values are held out whole, such as `material`.
        withheld: columns that neither the model nor the loop is given, such as `tdc`.
        calibration_s: seconds at the start of each segment in which a user's own sensor is measured.
        least_share: the share of the error that an effect must remove to be named.
        exclude: effects that are not tried, such as `temperature`.
        reference: whether what an effect explains of the model's own held-out residual is subtracted.
        constants: of the inference; `least_share` above counts in place of theirs.
        residual_model: whether to fit a model of what no effect explains.
        stability: on so many random halves of the blocks, effects are named anew and counted; 0 for none.
    """

    seed: int = 0
    held_out: float = 0.3
    hold_out_by: str | None = None
    withheld: tuple[str, ...] = ()
    calibration_s: float = 0.0
    least_share: float = DECLARED.least_share
    exclude: tuple[str, ...] = ()
    reference: bool = True
    constants: Constants = DECLARED
    residual_model: bool = False
    stability: int = 0


@dataclass(frozen=True)
class LoopResult:
    """The result of the loop.

    Attributes:
        findings: the report's content.
        observations: the rows, before any input was moved.
        blocks: the fit part and the evaluation part.
        attribution: the named effects, with their contributions to each row.
        new: the effects of the corrected model.
        after: (n, 21) the corrected model's predictions, counts.
        left: (n, 21) what it does not explain, nor an effect that is only reported, counts.
        constants: of the inference, as they were raised for kinds that the model was not trained on.
        reference: the model's own held-out residual, as it was taken into account.
        changes: of single channels in the course of the recordings.
    """

    findings: Findings
    observations: Observations
    blocks: Blocks
    attribution: Attribution
    new: NewEffects
    after: Floats
    left: Floats
    constants: Constants
    reference: HeldOutResidual | None
    changes: tuple[SensitivityChange | ReadingChange, ...]

    def served_windows(self, rows: int) -> NDArray[np.float32]:
        """(m, f) windows as the corrected model takes them, m up to `rows`."""
        return served_windows(self.observations, self.attribution, self.new, rows)

    def exported(self, version: str) -> "LoopResult":
        """The same, exported as a version such as `xgb/2`."""
        return replace(self, findings=self.findings.model_copy(update={"exported": version}))


@dataclass(frozen=True)
class _Given:
    """What effects are looked for in.

    Attributes:
        recordings: that were compared with the model.
        observations: their rows.
        blocks: the fit part and the evaluation part.
        settings: of the loop.
        own: the model's own held-out residual; None if it is not known.
        reference: the same for the kinds of these recordings, as far as it is taken into account.
        new_kinds: (n,) rows of kinds that the model was not trained on, of each column that has some.
    """

    recordings: Sequence[Recording]
    observations: Observations
    blocks: Blocks
    settings: LoopSettings
    own: HeldOutResidual | None
    reference: HeldOutResidual | None
    new_kinds: Mapping[str, NDArray[np.bool_]]


@dataclass(frozen=True)
class _Corrected:
    """What was named, and the model that has it.

    Attributes:
        attribution: the named effects.
        figures: of each named effect, its parameters.
        new: the effects of the corrected model.
        after: (n, 21) its predictions, counts.
        left: (n, 21) what neither it explains nor an effect that is only reported, counts.
        residual_model: what predicts a part of what no effect explains; None without one.
    """

    attribution: Attribution
    figures: Mapping[str, list[Parameter]]
    new: NewEffects
    after: Floats
    left: Floats
    residual_model: FoundResidualModel | None


def run_loop(
    model: Model,
    recordings: Sequence[Recording],
    settings: LoopSettings,
    progress: StatusCallback = silent,
    reference: HeldOutResidual | None = None,
) -> LoopResult:
    """Names effects, and measures the corrected model on blocks that nothing was fitted to.

    Args:
        progress: is told what the loop looks at.
        reference: the model's own held-out residual, in place of that of its manifest.

    Raises:
        RecordingError: the recordings are too short to hold anything out, lack a column, have places or
            forces in another unit, or tared counts where the model has raw ones, or the other way round.
    """
    progress("predicting")
    observations = _observed(model, recordings, settings)
    blocks = cut(observations, seed=settings.seed, held_out=settings.held_out, group=settings.hold_out_by)
    own = reference or model.manifest.held_out_residual
    known, new = _taken_into_account(own, observations, settings), new_kinds(observations)
    given = _Given(recordings, observations, blocks, settings, own, known, new)
    constants = _constants(settings, new)
    effects = [effect for effect in candidates(observations) if effect.label not in settings.exclude]
    attribution = JointSelection(
        observations, blocks, effects, reference=known, constants=constants, progress=progress
    ).run()
    found = _corrected(given, attribution, progress)
    changes = _changes(given, attribution)
    findings = _findings(given, found, changes)
    if settings.stability:
        stability = on_halves(
            observations,
            blocks,
            effects,
            attribution,
            settings.stability,
            seed=settings.seed,
            reference=known,
            constants=constants,
            progress=progress,
        )
        findings = findings.model_copy(update={"stability": stability})
    return LoopResult(
        findings,
        observations,
        blocks,
        attribution,
        found.new,
        found.after,
        found.left,
        constants,
        known,
        changes,
    )


def _observed(model: Model, recordings: Sequence[Recording], settings: LoopSettings) -> Observations:
    for recording in recordings:
        check_units(recording, model.manifest.trained_contacts)
    observations = gather(model, recordings, withheld=settings.withheld)
    check_scale(model.manifest.label, observations.pressed, observations.base, observations.measured)
    return observations.calibrated(settings.calibration_s) if settings.calibration_s else observations


def _taken_into_account(
    own: HeldOutResidual | None, observations: Observations, settings: LoopSettings
) -> HeldOutResidual | None:
    """A model's own held-out residual, as far as it is subtracted; its spectrum counts in any case."""
    if own is None:
        return None
    own = of_its_kinds(own, observations, settings.constants)
    if settings.reference:
        return own
    return own.model_copy(
        update={"structure": {}, "sensitivity_change": None, "correlated": None, "waves": ()}
    )


def _constants(settings: LoopSettings, new: Mapping[str, NDArray[np.bool_]]) -> Constants:
    declared = replace(settings.constants, least_share=settings.least_share)
    shares = [float(rows.mean()) for rows in new.values()]
    return declared.with_new_kinds(max(shares)) if shares and settings.reference else declared


def _corrected(given: _Given, attribution: Attribution, progress: StatusCallback) -> _Corrected:
    observations, settings = given.observations, given.settings
    figures = {named.name: parameters(named) for named in attribution.named}
    new = NewEffects.of(attribution, figures)
    after = corrected(observations, attribution, new)
    told = None
    if settings.residual_model:
        progress("what no effect explains")
        unexplained = observations.measured - after
        unnamed = residual_model(
            observations,
            attribution,
            given.blocks,
            unexplained,
            exclude=settings.exclude,
            seed=settings.seed,
        )
        if unnamed is not None:
            before, new = after, unnamed.added_to(new)
            after = corrected(observations, attribution, new)
            told = unnamed.found(observations, given.blocks, before, after)
    left = _left(observations, attribution, new, after)
    return _Corrected(attribution, figures, new, after, left, told)


def _left(observations: Observations, attribution: Attribution, new: NewEffects, after: Floats) -> Floats:
    """(n, 21) counts that neither the corrected model explains nor an effect that cannot be served."""
    served = {effect.name for effect in new.effects}
    left = observations.measured - after
    for named in attribution.named:
        left = left if named.name in served else left - named.contribution
    return left


def _changes(given: _Given, attribution: Attribution) -> tuple[SensitivityChange | ReadingChange, ...]:
    """Of single channels, beside what named effects other than their own explain."""
    # A channel that holds another one's signal has not changed.
    others = [
        named.contribution
        for named in attribution.named
        if named.name not in (Gain.name, Fault.name) or is_crossed(named.candidate.form)
    ]
    explained = np.sum(others, axis=0) if others else np.zeros_like(given.observations.residual)
    known = ~np.any(list(given.new_kinds.values()), axis=0) if given.new_kinds else None
    return changed_channels(given.observations, given.blocks, explained, given.reference, known)


def _one_kind(given: _Given) -> tuple[str, ...]:
    """Columns of which the model's error is known for several values together, and these have one."""
    own = given.own
    if own is None:
        return ()
    return tuple(
        name
        for name, values in given.observations.covariates.items()
        if f"covariate:{name}" in own.structure
        and name not in own.one_kind
        and values.min() == values.max()
    )


def _looks_wrong(given: _Given) -> tuple[str, ...]:
    """What looks wrong in the recordings, beside the contacts that the model was trained on."""
    trained = given.observations.manifest.trained_contacts
    return tuple(
        f"{source.name}: {text}"
        for source in given.recordings
        for _, text in recording_findings(source, trained)
    )


def _told(given: _Given) -> tuple[NewKinds, ...]:
    """Which kinds are new, with their share."""
    return tuple(
        NewKinds(
            column=column,
            values=tuple(np.unique(given.observations.covariates[column][rows]).tolist()),
            share=float(rows.mean()),
        )
        for column, rows in given.new_kinds.items()
    )


def _error_ratio(given: _Given) -> dict[str, float]:
    """Of each channel, how many times as much the model is off by here as on what training held out."""
    if given.own is None:
        return {}
    off_by = np.sqrt((given.observations.residual[given.blocks.evaluation] ** 2).mean(axis=0))
    pairs = zip(CHANNELS, off_by.tolist(), given.own.std, strict=True)
    return {name: here / usual for name, here, usual in pairs if usual > 0.0}


def _findings(
    given: _Given, found: _Corrected, changes: Sequence[SensitivityChange | ReadingChange]
) -> Findings:
    observations, blocks, settings = given.observations, given.blocks, given.settings
    attribution = found.attribution
    manifest = observations.manifest
    rows, output_std = blocks.evaluation, np.array(manifest.normalisation.output_std)
    noise = NoiseFloor.of(observations, attribution.waves)
    energy = (observations.residual[rows] ** 2).mean(axis=0)
    measured = observations.measured[rows]
    return Findings(
        model=manifest.label,
        data=tuple(
            {
                "name": source.name,
                "format": source.format,
                "rows": len(source),
                "sha256": source.fingerprint,
            }
            for source in given.recordings
        ),
        split={
            "unit": settings.hold_out_by or "blocks",
            "blocks": len(blocks),
            "evaluation_blocks": int((blocks.fold < 0).sum()),
            "folds": min(FOLDS, int(blocks.fold.max()) + 1),
            "rows": len(observations),
            "evaluation_rows": int(rows.sum()),
            "seed": settings.seed,
            "measured_temperature": "tdc" not in settings.withheld,
            "calibration_s": settings.calibration_s,
            "least_share": settings.least_share,
            "reference": settings.reference,
            "reference_rows": 0 if given.reference is None else given.reference.rows,
        },
        noise_floor=noise.report(energy, output_std),
        effects=found_effects(observations, attribution, found.figures, found.new, rows),
        rejected=attribution.rejected,
        before=ErrorMetrics.of(measured, observations.predicted[rows], output_std).report(),
        after=ErrorMetrics.of(measured, found.after[rows], output_std).report(),
        test=paired_test(observations, blocks, found.after, output_std),
        unexplained=diagnose_residual(observations, found.left, noise, rows),
        error_ratio=_error_ratio(given),
        looks_wrong=_looks_wrong(given),
        changes=tuple(change.sentence() for change in changes),
        one_kind=_one_kind(given),
        new_kinds=_told(given),
        residual_model=found.residual_model,
        confounding=confounding(observations),
        autocorrelation=autocorrelations(observations, observations.residual, found.left, rows),
        cross_correlation=cross_correlations(observations, blocks, observations.residual, found.left),
        parameter_correlation=attribution.correlation,
    )
