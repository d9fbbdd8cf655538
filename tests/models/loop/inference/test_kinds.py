"""What a model gets wrong anyway on one material, and what that means for a recording of it alone."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taxel.held_out_residual import (
    CorrelatedResidual,
    HeldOutResidual,
    KindResidual,
    KnownKind,
    OwnStructure,
)
from taxel.manifest import Manifest
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.covariate import Covariate
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.kinds import all_forms, of_its_kinds
from taxel_models.loop.inference.scoring import Scoring
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.reference.held_out import KEPT, held_out_residual
from taxel_models.loop.report.wording import opening
from taxel_models.loop.status import silent
from taxel_models.model import Model
from taxel_models.recordings import Recording

Make = Callable[..., Recording]
SHARES = {1.0: 0.14, 2.0: -0.14, 3.0: 0.0, 4.0: 0.25}
"""By which the signal of each kind is larger than the model says."""


def own(gain: float) -> OwnStructure:
    return OwnStructure(log_evidence=(gain / 10.0,) * 21, gain=(gain,) * 21)


def known() -> HeldOutResidual:
    structure = {"gain": own(8.0), "drift": own(0.1)}
    one = KindResidual(std=(2.0,) * 21, structure=structure, herfindahl=0.1)
    same = (0.2,) * 21
    structure = {"gain": own(1.0), "drift": own(0.5), "offset:contact": own(3.0)}
    return HeldOutResidual(
        rows=900, std=(3.0,) * 21, shared=same, fading=same, structure=structure, one_kind={"material": one}
    )


def of(observations: Observations, values: list[float]) -> HeldOutResidual:
    """What is known, for a recording of these materials."""
    column = np.resize(np.array(values), len(observations))
    return of_its_kinds(known(), replace(observations, covariates={"material": column}), DECLARED)


def test_one_kind_is_judged_as_such(observations: Observations) -> None:
    one = of(observations, [7.0])
    assert one.structure["gain"].gain[0] == pytest.approx(8.0)
    # A residual of 4 counts: 2 squared of 16 are the kind's own, 3 squared of 16 are usual of the model.
    assert one.structure["gain"].log_evidence[0] == pytest.approx(0.8 * 4.0 / 9.0, rel=1e-3)
    assert one.one_kind == {}


def test_a_kind_that_is_known_by_itself_may_show_what_it_showed(observations: Observations) -> None:
    kinds = {
        "7": KnownKind(std=(2.0,) * 21, structure={"gain": own(2.0)}),
        "9": KnownKind(std=(4.0,) * 21, structure={"gain": own(40.0)}, correlated={"drift": own(9.0)}),
    }
    whole = known()
    material = whole.one_kind["material"].model_copy(
        update={"kinds": kinds, "correlated": {"drift": own(3.0)}}
    )
    beside = CorrelatedResidual(
        precision=tuple(map(tuple, np.eye(21).tolist())),
        shared=whole.shared,
        fading=whole.fading,
        structure={"drift": own(2.0)},
    )
    whole = whole.model_copy(update={"one_kind": {"material": material}, "correlated": beside})

    def judged(*values: float) -> HeldOutResidual:
        column = {"material": np.resize(np.array(values), len(observations))}
        return of_its_kinds(whole, replace(observations, covariates=column), DECLARED)

    gains = [judged(kind).structure["gain"].gain[0] for kind in (7.0, 9.0, 5.0)]
    assert gains == pytest.approx([2.0, 40.0, 8.0], rel=0.01)
    assert judged(7.0, 9.0).structure["gain"].gain[0] == pytest.approx(1.0 + 20.0 * 0.4 / 0.9, rel=0.01)
    # Of few contacts of a kind, nobody knows how their offsets scatter: more, the larger its error is.
    assert judged(9.0).structure["offset:contact"].gain[0] == pytest.approx(
        2.0 * 3.0 * 16.0 / 9.0, rel=0.01
    )
    found = [judged(kind).correlated for kind in (7.0, 9.0)]
    assert [one.structure["drift"].gain[0] for one in found if one] == pytest.approx([3.0, 9.0])


def test_what_one_kind_does_not_show_all_together_do(observations: Observations) -> None:
    one = of(observations, [7.0])
    assert one.structure["drift"].gain[0] == pytest.approx(0.5)
    assert one.structure["offset:contact"].gain[0] == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("of_one_kind", "expected"),
    [({}, 8.0), ({"gain, alike": own(6.0)}, 6.0), ({"gain, ageing, alike": own(9.0)}, 9.0)],
)
def test_of_what_ages_a_kind_shows_at_least_what_its_few_rows_tell(
    observations: Observations, of_one_kind: dict[str, OwnStructure], expected: float
) -> None:
    """A gain that all channels share and that ages is judged by the nearest that the kind has."""
    whole = known()
    material = whole.one_kind["material"]
    material = material.model_copy(update={"structure": {**material.structure, **of_one_kind}})
    structure = {**whole.structure, "gain, ageing, alike": own(1.5)}
    whole = whole.model_copy(update={"structure": structure, "one_kind": {"material": material}})
    column = {"material": np.full(len(observations), 7.0)}
    found = of_its_kinds(whole, replace(observations, covariates=column), DECLARED)
    assert found.structure["gain, ageing, alike"].gain[0] == pytest.approx(expected)


def test_own_parts_of_several_kinds_cancel_out(observations: Observations) -> None:
    both = of(observations, [1.0, 2.0])
    assert both.structure["gain"].gain[0] == pytest.approx(1.0 + 7.0 * 0.4 / 0.9, rel=1e-3)
    unequal = of(observations, [1.0] * 9 + [2.0])
    assert unequal.structure["gain"].gain[0] == pytest.approx(1.0 + 7.0 * 0.72 / 0.9, rel=1e-2)
    for kinds in (10, 30):
        many = of(observations, list(range(kinds)))
        assert many.structure["gain"].gain[0] == pytest.approx(1.0, rel=1e-2)


def test_kinds_that_were_never_compared_may_differ_as_much_as_one_shows(observations: Observations) -> None:
    """Each kind has a weight of its own, so that they do not cancel out."""
    both = of(observations, [1.0, 2.0])
    assert both.structure["covariate:material"].gain[0] == pytest.approx(8.0)
    compared = known()
    compared.structure["covariate:material"] = own(5.0)
    column = {"material": np.resize(np.array([1.0, 2.0]), len(observations))}
    found = of_its_kinds(compared, replace(observations, covariates=column), DECLARED)
    assert found.structure["covariate:material"].gain[0] == pytest.approx(5.0)


def test_what_one_kind_shows_beside_all_channels_counts_likewise(observations: Observations) -> None:
    whole = known()
    material = whole.one_kind["material"].model_copy(update={"correlated": {"drift": own(9.0)}})
    precision = tuple(map(tuple, np.eye(21).tolist()))
    beside = CorrelatedResidual(
        precision=precision, shared=whole.shared, fading=whole.fading, structure={"drift": own(2.0)}
    )
    whole = whole.model_copy(update={"one_kind": {"material": material}, "correlated": beside})
    column = {"material": np.full(len(observations), 7.0)}
    found = of_its_kinds(whole, replace(observations, covariates=column), DECLARED)
    assert found.correlated is not None
    assert found.correlated.structure["drift"].log_evidence[0] == pytest.approx(0.9)


def test_a_recording_without_the_column_is_judged_by_all_together(observations: Observations) -> None:
    together = known().model_copy(update={"one_kind": {}})
    assert of_its_kinds(known(), replace(observations, covariates={}), DECLARED) == together


def errs_by_kind(smooth: Any, make: Make, seed: int, kinds: list[float]) -> Recording:
    """The model's signal is off by another share on each material, and right in the mean."""
    recording = make(9_000, seed=seed)
    material = np.repeat(np.resize(np.array(kinds), 30), 300)
    signal = smooth.counts(recording.samples.position, recording.samples.force) - smooth.counts(
        recording.samples.position, 0.0 * recording.samples.force
    )
    share = np.array([SHARES[one] for one in material])[:, None]
    channels = np.clip(np.rint(recording.channels + share * signal), 0, 4095)
    return replace(recording, channels=channels, covariates={"material": material})


@pytest.fixture(scope="module")
def trained(smooth: Any) -> "Trained":
    return Trained(smooth, (1.0, 2.0, 3.0))


@pytest.fixture(scope="module")
def reference(smooth: Any, make: Make, trained: "Trained", quick_references: None) -> HeldOutResidual:
    del quick_references
    found = held_out_residual(trained, [errs_by_kind(smooth, make, 8, [1.0, 2.0, 3.0])])
    assert found is not None
    return found


def test_a_models_error_on_one_material_is_no_gain_of_the_sensor(
    smooth: Any, make: Make, reference: HeldOutResidual
) -> None:
    assert set(reference.one_kind) == {"material"}
    kinds = reference.one_kind["material"].kinds
    gains = {kind: sum(own.structure["gain"].gain) for kind, own in kinds.items()}
    assert set(gains) == {"1", "2", "3"}
    # The model is right on the third.
    assert gains["3"] < 0.1 * min(gains["1"], gains["2"])
    manifest = smooth.manifest.model_copy(update={"held_out_residual": reference})
    assert Manifest.model_validate_json(manifest.model_dump_json()) == manifest

    recording = errs_by_kind(smooth, make, 4, [1.0])
    reference = reference.model_copy(update={"new_kinds": {}})
    together = reference.model_copy(update={"one_kind": {}})
    # A force sensor's gain does nearly the same.
    settings = LoopSettings(exclude=("frame",))
    first = run_loop(smooth, [recording], settings, reference=together).findings
    assert "gain" in [effect.name for effect in first.effects]
    assert first.one_kind == ("material",)
    second = run_loop(smooth, [recording], settings, reference=reference).findings
    assert second.effects == ()
    assert second.one_kind == ()


@pytest.mark.long
def test_a_kind_is_judged_by_the_noise_of_all(smooth: Any, make: Make) -> None:
    """The others scatter from contact to contact. A gain of this kind is judged as if it did, too."""
    recording = make(9_000, seed=8)
    material, contact = (np.repeat(np.resize(one, 30), 300) for one in ([1.0, 3.0, 5.0], np.arange(30)))
    first = (material == 1.0)[:, None]
    position, force = recording.samples.position, recording.samples.force
    signal = smooth.counts(position, force) - smooth.counts(position, 0.0 * force)
    scatter = (np.random.default_rng(1).normal(size=(30, 21)) * 30.0)[contact]
    recording = replace(
        recording,
        samples=replace(recording.samples, time_ns=recording.samples.time_ns + 1_000_000_000 * contact),
        channels=np.rint(recording.channels + np.where(first, 0.04 * signal, scatter)),
        covariates={"material": material},
    )
    reference = held_out_residual(smooth, [recording])
    assert reference is not None
    assert np.median(reference.shared) > 0.5
    usual = sum(reference.one_kind["material"].kinds["1"].structure["gain"].gain)

    observations = gather(smooth, [recording])
    alone = observations.kept(observations.covariates["material"] == 1.0)
    unknown = reference.model_copy(update={"structure": {}, "correlated": None})
    scoring = Scoring(alone, cut(alone, seed=0, held_out=KEPT), [Gain()], unknown, DECLARED, silent)
    (score,) = (score for score in scoring.scores([]) if score.name == "gain")
    unit = scoring.bases([]).beside.noise * scoring.whitening.scale**2
    may = usual * len(scoring.bins) / (score.gain.sum(axis=0) * unit).sum()
    assert DECLARED.usual_of_kind * 0.8 < may < DECLARED.usual_of_kind * 1.4


@pytest.mark.long
def test_a_wave_that_a_kind_has_is_usual_of_it(smooth: Any, make: Make) -> None:
    """The texture of a material gives a wave wherever the finger slides over it as fast."""

    def slid(seed: int, kinds: list[float], size: float) -> Recording:
        recording = make(9_000, seed=seed)
        material = np.repeat(np.resize(np.array(kinds), 30), 300)
        wave = size * np.sin(2 * np.pi * 5.1 * np.arange(9_000) / 100.0) * (material == 1.0)
        counts = recording.channels.copy()
        counts[:, [4, 9]] = np.rint(counts[:, [4, 9]] + wave[:, None])
        return replace(recording, channels=counts, covariates={"material": material})

    reference = held_out_residual(smooth, [slid(8, [1.0, 2.0, 3.0], 4.0)])
    assert reference is not None
    kinds = reference.one_kind["material"].kinds
    (own,) = (wave for wave in kinds["1"].waves if abs(wave.frequency_hz - 5.1) < 0.1)
    assert own.energy[4] == pytest.approx(8.0, rel=0.2)
    assert max(own.energy[10:]) < 1.0
    manifest = smooth.manifest.model_copy(update={"held_out_residual": reference})
    assert Manifest.model_validate_json(manifest.model_dump_json()) == manifest

    def named(recording: Recording, *, by_reference: bool = True) -> list[str]:
        settings = LoopSettings(reference=by_reference)
        findings = run_loop(smooth, [recording], settings, reference=reference).findings
        return [effect.form for effect in findings.effects]

    assert named(slid(4, [1.0], 4.0)) == []
    assert named(slid(4, [1.0], 4.0), by_reference=False) == ["5.1 Hz in e3, e8"]
    assert named(slid(4, [1.0], 12.0)) == ["5.1 Hz in e3, e8"]


def trained_on(observations: Observations, *kinds: float) -> Observations:
    """The same rows, by a model that knows these materials."""
    return replace(observations, model=Trained(observations.model, kinds))


class Trained:
    """A model whose manifest says which materials it was trained on."""

    def __init__(self, model: Model, kinds: tuple[float, ...]) -> None:
        training = model.manifest.training
        assert training is not None
        assert training.contacts is not None
        contacts = training.contacts.model_copy(update={"kinds": {"material": kinds}})
        training = training.model_copy(update={"contacts": contacts})
        self.manifest = model.manifest.model_copy(update={"training": training})
        self.predict, self.predict_base = model.predict, model.predict_base


def test_new_kinds_show_as_large_a_part_as_those_that_stand_ins_did_not_see(
    observations: Observations,
) -> None:
    unseen = known().model_copy(update={"structure": {"gain": own(20.0), "covariate:material": own(6.0)}})
    structure = known().structure | {"covariate:material": own(5.0)}
    reference = known().model_copy(update={"new_kinds": {"material": unseen}, "structure": structure})
    energy = float((observations.residual[:, 0] ** 2).mean())
    column = np.resize(np.array([1.0, 7.0]), len(observations))

    def usual(*kinds: float) -> HeldOutResidual:
        recorded = trained_on(replace(observations, covariates={"material": column}), *kinds)
        return of_its_kinds(reference, recorded, DECLARED)

    plain, half, all_new = usual(1.0, 7.0), usual(1.0), usual(2.0, 3.0)
    assert plain.structure["covariate:material"].gain[0] == pytest.approx(5.0)
    assert all_new.structure["covariate:material"].gain[0] == pytest.approx(6.0 * energy / 9.0, rel=1e-3)
    # One kind of the stand-ins' has 8 of 4 squared counts, all together 20 of 9.
    assert all_new.structure["gain"].gain[0] == pytest.approx(20.0 * energy / 9.0, rel=1e-3)
    before = plain.structure["gain"].gain[0]
    energy = float((observations.residual[column == 7.0, 0] ** 2).mean())
    together = 0.75 * before + 0.25 * 20.0 * energy / 9.0
    assert half.structure["gain"].gain[0] == pytest.approx(together, rel=1e-3)
    assert half.new_kinds == {}


@pytest.mark.long
def test_what_a_new_material_may_show_is_told_and_is_less_sure(
    smooth: Any, make: Make, trained: Trained, reference: HeldOutResidual
) -> None:
    assert set(reference.new_kinds) == {"material"}

    recording = errs_by_kind(smooth, make, 4, [4.0])
    unaware = reference.model_copy(update={"new_kinds": {}})
    first, second = (
        run_loop(trained, [recording], LoopSettings(), reference=one).findings
        for one in (unaware, reference)
    )
    unaware_of, aware_of = (
        next(one for one in findings.effects if one.name == "gain") for findings in (first, second)
    )
    # More of it is usual, so that it is less sure.
    assert 0.0 < unaware_of.p_value < aware_of.p_value
    for findings in (first, second):
        (new,) = findings.new_kinds
        assert (new.column, new.values, new.share) == ("material", (4.0,), 1.0)
        assert "not trained on material 4 (100 % of the rows)" in opening(findings, ())
    seen = run_loop(trained, [errs_by_kind(smooth, make, 4, [1.0])], LoopSettings(), reference=reference)
    assert seen.findings.new_kinds == ()


def test_numbers_of_contacts_are_no_covariate(observations: Observations) -> None:
    numbers = replace(observations, covariates={"trial": observations.segment.astype(np.float64)})
    several = replace(observations, segment=np.arange(len(observations)) // 300)
    trial = replace(several, covariates={"trial": several.segment.astype(np.float64)})
    assert "number the contacts" in (Covariate("trial").out_of_scope(trial) or "")
    twice = replace(several, covariates={"trial": several.segment // 2.0})
    assert Covariate("trial").out_of_scope(twice) is None
    assert Covariate("trial").out_of_scope(numbers) is None


def test_a_form_that_any_kind_has_is_usual() -> None:
    first, second = (
        own(1.0).model_copy(update={"forms": forms}) for forms in (("10 ms",), ("-10 ms", "10 ms"))
    )
    assert all_forms("lag", [{"lag": first}, {"lag": second}, {}]) == ("-10 ms", "10 ms")
    assert all_forms("lag", [{"lag": first}, {"lag": own(1.0)}]) == ()
    assert all_forms("lag", [{}]) == ()


def test_forms_of_single_kinds_are_usual_where_most_of_it_is_theirs(observations: Observations) -> None:
    """All kinds together say more of a recording of many than what any of a few contacts leaves open."""
    whole = known()
    whole.structure["lag"] = own(2.0).model_copy(update={"forms": ("-10 ms",)})
    whole.one_kind["material"].structure["lag"] = own(8.0).model_copy(update={"forms": ("20 ms",)})

    def usual(kinds: int) -> OwnStructure:
        column = np.arange(len(observations)) * kinds // len(observations)
        seen = replace(observations, covariates={"material": column.astype(np.float64)})
        return of_its_kinds(whole, seen, DECLARED).structure["lag"]

    assert usual(10).forms == ("-10 ms",)
    assert usual(10).gain[0] == pytest.approx(2.0, rel=0.01)
    # Of four kinds, a sixth of the recording stands for one alone, which has four times as much.
    assert usual(4).forms == ("-10 ms",)
    assert usual(2).forms == usual(1).forms == ("-10 ms", "20 ms")
