"""What ages: it acts in some folds more than in others, and so does what is usual of it."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.held_out_residual import AGEING, ALIKE, HeldOutResidual, OwnStructure
from taxel_models.loop.basis import Shared
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.drift import Drift
from taxel_models.loop.effects.effect import Candidate, Fitting, Remaining
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.evidence import HeldOut
from taxel_models.loop.inference.score import Score
from taxel_models.loop.inference.scoring import Scoring
from taxel_models.loop.inference.usual import Usual
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.reference.held_out import held_out_residual
from taxel_models.loop.status import silent
from taxel_models.recordings import Recording

pytestmark = pytest.mark.usefixtures("quick_references")

Make = Callable[..., Recording]
Floats = NDArray[np.float64]
FADES = CHANNELS.index("e4")


class NeverAgeing(Gain):
    """Forms of a gain that count as alike in all folds."""

    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        for form in super().forms(observations, remaining):
            yield replace(form, ages=False)


def noisy(recording: Recording, seed: int) -> Recording:
    counts = recording.channels + np.random.default_rng(seed).normal(size=recording.channels.shape) * 8.0
    return replace(recording, channels=np.rint(counts))


def fading(recording: Recording, share: float) -> Recording:
    """An electrode loses a share of its signal by the end."""
    counts = recording.channels.copy()
    own = counts[:, FADES]
    counts[:, FADES] = np.rint(own - np.linspace(0.0, share, len(own)) * (own - own.mean()))
    return replace(recording, channels=counts)


@pytest.fixture(scope="module")
def reference(smooth: Any, make: Make) -> HeldOutResidual:
    found = held_out_residual(smooth, [noisy(make(seed=8, materials=False), seed=1)])
    assert found is not None
    return found


def scored(effect: Gain, observations: Observations, reference: HeldOutResidual) -> Score:
    scoring = Scoring(observations, cut(observations, seed=0), [effect], reference, DECLARED, silent)
    return next(score for score in scoring.scores([]) if score.name == "gain")


def with_usual_gain(reference: HeldOutResidual, gain: float) -> HeldOutResidual:
    """The reference where the electrode's own gain takes so much off its error, counts² for each bin.

    It is the same of gains that age and of others.
    """
    known = reference.structure["gain"]
    every = np.array(known.gain)
    every[FADES] = gain
    usual = known.model_copy(update={"gain": tuple(every.tolist())})
    other = {name: own for name, own in reference.structure.items() if not name.startswith("gain")}
    return reference.model_copy(update={"structure": {**other, "gain": usual}, "correlated": None})


def test_an_ageing_gain_repeats_more_surely_where_what_is_usual_counts_as_it_acts(
    smooth: Any, make: Make, reference: HeldOutResidual
) -> None:
    observations = gather(smooth, [fading(noisy(make(12_000, seed=4), seed=2), 0.6)])
    known = with_usual_gain(reference, 45.0)
    ageing, alike = (scored(one, observations, known) for one in (Gain(), NeverAgeing()))
    assert ageing.form.candidate.form == alike.form.candidate.form
    assert ageing.form.candidate.ages
    assert ageing.total_gain == pytest.approx(alike.total_gain)
    assert alike.t < DECLARED.least_t(alike.folds) < ageing.t


def test_a_form_has_what_is_usual_of_forms_with_at_most_its_freedom(reference: HeldOutResidual) -> None:
    names = ("gain", f"gain{AGEING}", f"gain{ALIKE}", f"gain{AGEING}{ALIKE}")
    assert {name for name in reference.structure if name.startswith("gain")} == set(names)
    steady, ageing, alike, _ = (sum(reference.structure[name].gain) for name in names)
    assert alike <= steady <= ageing

    def usual_of(structure: dict[str, OwnStructure], *, ages: bool, pooled: bool) -> float:
        known = reference.model_copy(update={"structure": structure})
        candidate = Candidate(
            "gain", "", Shared(np.ones((9, 1))), fitting=Fitting(pooled=pooled), ages=ages
        )
        usual = Usual(known, np.zeros(9, np.int64), np.array(reference.std))
        return float(np.broadcast_to(usual.log_evidence("gain", candidate), 21)[0])

    structure = {
        name: OwnStructure(log_evidence=(float(place),) * 21, gain=(0.0,) * 21)
        for place, name in enumerate(names, start=1)
    }
    assert [
        usual_of(structure, ages=ages, pooled=pooled) for pooled in (False, True) for ages in (False, True)
    ] == [9.0, 18.0, 27.0, 36.0]
    # A manifest of an earlier version has one figure for all forms.
    earlier = {"gain": structure["gain"]}
    assert {usual_of(earlier, ages=ages, pooled=ages) for ages in (False, True)} == {9.0}


def test_what_is_usual_of_a_drift_counts_by_how_far_it_has_come(observations: Observations) -> None:
    every = np.ones(len(observations))
    forms = list(Drift().forms(observations, Remaining(observations.residual, every > 0, every)))
    assert {form.form.split()[0] for form in forms} >= {"line", "6", "an", "a"}
    for form in forms:
        assert form.acts_unevenly
        assert form.again is not None
        assert form.again(observations).acts_unevenly


@pytest.mark.parametrize("acts", ["evenly", "ages", "uneven", "moves"])
def test_folds_have_what_is_usual_by_their_change_or_by_their_bins(
    reference: HeldOutResidual, acts: str
) -> None:
    fold = np.repeat([0, 1, 2], [10, 10, 20])
    scale = 2.0 * np.array(reference.std)
    change = np.random.default_rng(3).uniform(0.5, 2.0, (3, 21))
    tested = HeldOut(np.ones((3, 21)), np.ones((3, 21)), np.full(21, 0.5), change)
    candidate = Candidate("gain", "by channel", Shared(np.ones((40, 1))))
    if acts == "moves":
        # What is usual of a turned finger shows where it presses.
        candidate = replace(candidate, moved=lambda observations: observations)
    elif acts != "evenly":
        candidate = replace(candidate, **{acts: True})
    found = Usual(with_usual_gain(reference, 20.0), fold, scale).gain(candidate, tested)
    part = change / change.sum(axis=0) if acts != "evenly" else np.array([[0.25], [0.25], [0.5]])
    # Over the noise of a bin, whose mean square is half of the squared scale.
    whole = 40 * 20.0 / (0.5 * scale[FADES] ** 2)
    np.testing.assert_allclose(
        np.asarray(found)[:, FADES], whole * np.broadcast_to(part, change.shape)[:, FADES]
    )
