"""Causes are drawn as the rules say, and a round is marked by what was injected."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel.errors import SettingsError
from taxel_models.ground.ground import ALL_CHANNELS, Clean, predicted
from taxel_models.ground.twins import contacts_of
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.selection import JointSelection
from taxel_models.loop.observations import gather
from taxel_models.recordings import Recording
from taxel_models.recovery.benchmark import all_named, run_round
from taxel_models.recovery.injected import Draw, inject_drawn
from taxel_models.recovery.injection import Injection
from taxel_models.recovery.injectors import inject
from taxel_models.recovery.naming import without_effects
from taxel_models.recovery.own_ground import CleanTwins

Make = Callable[..., Recording]


def clean_of(model: Any, recording: Recording, **others: Any) -> Clean:
    fields: dict[str, Any] = {"on_skin": True, "live": ALL_CHANNELS, **others}
    return Clean(model, recording, None, contact=contacts_of(recording), **fields)


def injected(clean: Clean, draw: Draw, number: int) -> Any:
    counts, rows = predicted(clean.model, clean.recording)
    residual = clean.recording.channels[rows] - counts
    return inject_drawn(clean, residual, draw, np.random.default_rng([0, number]))


def test_rounds_are_drawn_as_the_rules_say() -> None:
    drawn = [Draw().kind(np.random.default_rng([0, number])) for number in range(4000)]
    kinds = [kind for kind, _ in drawn]
    strengths = [strength for kind, strength in drawn if kind != "clean"]
    assert np.mean([kind == "clean" for kind in kinds]) == pytest.approx(0.2, abs=0.02)
    assert np.mean([kind == "unknown" for kind in kinds]) == pytest.approx(0.1, abs=0.02)
    assert 0.5 <= min(strengths) < 0.55
    assert 1.9 < max(strengths) <= 2.0


def test_a_clean_round_changes_nothing(smooth: Any, recording: Recording) -> None:
    for injector in ("own", "foreign"):
        found = injected(clean_of(smooth, recording), Draw(injector, clean_share=1.0), 3)
        assert (found.truth, found.strength, found.accepted) == ("none", 0.0, ())
        np.testing.assert_array_equal(found.recording.channels, recording.channels)


def test_foreign_causes_are_drawn_evenly_and_unknown_ones_have_no_name(smooth: Any, make: Make) -> None:
    clean = clean_of(smooth, make(2000))
    found = [injected(clean, Draw("foreign"), number) for number in range(150)]
    causes = {one.truth.partition(":")[0] for one in found}
    assert {"none", "unknown", "creep", "drift", "fault", "gain", "covariate", "location"} <= causes
    assert all(not one.accepted for one in found if one.truth.startswith(("none", "unknown")))
    assert all(one.accepted for one in found if not one.truth.startswith(("none", "unknown")))


def test_only_what_is_asked_for_is_injected(smooth: Any, make: Make) -> None:
    clean = clean_of(smooth, make(2000))
    draw = Draw("foreign", ("creep", "drift: stepwise"), clean_share=0.0, unknown_share=0.0)
    truths = {injected(clean, draw, number).truth for number in range(40)}
    assert truths == {"creep: power law", "creep: two constants", "creep: relaxing", "drift: stepwise"}
    own = Draw("own", ("gain", "rate"), clean_share=0.0, unknown_share=0.0)
    assert {injected(clean, own, number).truth for number in range(20)} == {"gain", "rate"}


def test_what_a_ground_lacks_is_not_injected(smooth: Any, make: Make) -> None:
    live = tuple(name != "pdc" for name in CHANNELS)
    recording = make(2000)
    clean = clean_of(smooth, recording, on_skin=False, live=live)
    draw = Draw("foreign", ("location", "offset"), clean_share=0.0, unknown_share=0.0)
    for number in range(5):
        found = injected(clean, draw, number)
        assert found.truth == "offset"
        np.testing.assert_array_equal(found.recording.channels[:, 1], recording.channels[:, 1])
    with pytest.raises(SettingsError, match="location: no cause, or no second one, fits this ground"):
        injected(clean, Draw("foreign", ("location",), clean_share=0.0, unknown_share=0.0), 0)
    with pytest.raises(SettingsError, match="location: no cause, or no second one, fits this ground"):
        injected(clean, Draw("own", ("location",), clean_share=0.0, unknown_share=0.0), 0)
    with pytest.raises(SettingsError, match="gain: no cause, or no second one, fits this ground"):
        injected(clean, Draw("own", ("gain",), pairs=True, clean_share=0.0, unknown_share=0.0), 0)


def test_a_stuck_electrode_shows_no_other_cause(smooth: Any, make: Make) -> None:
    draw = Draw("foreign", ("fault: stuck", "rate"), pairs=True, clean_share=0.0, unknown_share=0.0)
    clean = clean_of(smooth, make(2000))
    rounds = [injected(clean, draw, number) for number in range(4)]
    assert len({found.truth.partition(" + ")[0] for found in rounds}) > 1, "either may be drawn first"
    for found in rounds:
        own = found.parameters["fault: stuck"]
        time_ns = found.recording.samples.time_ns
        since = (time_ns - time_ns[0]) / 1e9 >= own["since"]
        counts = found.recording.channels[since, CHANNELS.index(own["channel"])]
        assert len(np.unique(counts)) == 1


@pytest.mark.parametrize("injector", ["own", "foreign"])
def test_pairs_are_two_causes_with_names_of_their_own(smooth: Any, make: Make, injector: Any) -> None:
    clean = clean_of(smooth, make(2000))
    for number in range(12):
        found = injected(clean, Draw(injector, pairs=True, clean_share=0.0, unknown_share=0.0), number)
        first, second = found.truth.split(" + ")
        assert set(found.parameters) == {first, second}
        assert len(found.accepted) == 2
        assert not set(found.accepted[0]) & set(found.accepted[1])


def test_impossible_draws_are_refused() -> None:
    with pytest.raises(SettingsError, match="strengths 2 to 1: expected two above 0, the least first"):
        Draw(strengths=(2.0, 1.0))
    with pytest.raises(SettingsError, match="no cause wear: expected one of creep, crosstalk"):
        Draw("own", ("wear",))
    with pytest.raises(SettingsError, match=r"^no cause wear: expected one of .*crosstalk: converter"):
        Draw("foreign", ("creep", "wear"))


def test_each_cause_needs_a_name_of_its_own() -> None:
    assert all_named([["creep"]], ["gain", "creep"])
    assert all_named([["lag", "creep"], ["creep"]], ["creep", "lag"])
    assert not all_named([["lag", "creep"], ["creep"]], ["creep", "gain"])
    assert not all_named([["offset"], ["creep"]], ["creep"])


def test_a_round_is_marked_by_what_was_injected(smooth: Any, make: Make) -> None:
    draw = Draw("own", ("lag",), (2.0, 2.0), clean_share=0.0, unknown_share=0.0)
    one = run_round(clean_of(smooth, make(noise=4.0)), draw, 7, np.random.default_rng(0))
    assert (one.number, one.truth, one.found, one.named, one.right) == (7, "lag", "lag", ("lag",), True)
    assert one.parameter_error == pytest.approx(0.0, abs=0.01)
    assert one.clean < one.after * 1.01 < one.before
    assert one.removed == pytest.approx((one.before - one.after) / (one.before - one.clean))
    assert one.removed > 0.9
    assert one.all_named
    assert one.accepted == (("lag",),)


def named_in(smooth: Any, recording: Recording) -> list[str]:
    observations = gather(smooth, [recording])
    selection = JointSelection(observations, cut(observations, seed=1), candidates(observations))
    return [named.name for named in selection.run().named]


def test_the_reference_of_the_own_injectors_is_another_clean_twin(
    smooth: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    cleaned: list[Recording] = []

    def clean(model: Any, recording: Recording, seed: int) -> Recording:
        cleaned.append(recording)
        return recording

    monkeypatch.setattr("taxel_models.recovery.own_ground.without_effects", clean)
    ground = CleanTwins(smooth, 3, 5_000, recordings=2)
    rounds = [ground.clean(number) for number in range(4)]
    (reference,) = {id(one.reference) for one in rounds}
    played = {id(one.recording) for one in rounds}
    assert len(played) == 2
    assert {reference, *played} == {id(one) for one in cleaned}
    assert len(cleaned) == 3


def test_a_recording_without_effects_is_clean_on_another_split(
    smooth: Any, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    splits: list[int] = []

    def noted(observations: Any, *, seed: int) -> Any:
        splits.append(seed)
        return cut(observations, seed=seed)

    monkeypatch.setattr("taxel_models.recovery.naming.cut", noted)
    clean = make()
    injection = Injection.into(clean, 2, np.full(21, 12.0))
    inject(injection, "offset", 1.0)
    inject(injection, "rate", 0.5)
    assert set(named_in(smooth, injection.recording)) == {"offset", "rate"}
    found = without_effects(smooth, injection.recording, seed=0)
    assert splits == [*range(len(splits))]
    assert len(splits) > 1
    assert named_in(smooth, found) == []
    # What was injected is gone, and nothing else.
    change = (found.channels - clean.ticks().channels)[100:-100]
    assert np.sqrt((change**2).mean()) < 1.5
