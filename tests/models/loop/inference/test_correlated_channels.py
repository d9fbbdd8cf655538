"""Channels whose errors go along with each other are fitted together, as generalised least squares does."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.signal import lfilter

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.held_out_residual import CorrelatedResidual, HeldOutResidual, OwnStructure
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.crosstalk import Crosstalk
from taxel_models.loop.effects.drift import Drift
from taxel_models.loop.effects.effect import Effect, Remaining
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.correlated_channels import CorrelatedChannels
from taxel_models.loop.inference.few_channels_search import FewChannelsSearch
from taxel_models.loop.inference.named_in_channels import NamedInChannels
from taxel_models.loop.inference.score import UNSHRUNK
from taxel_models.loop.inference.selection import JointSelection
from taxel_models.loop.inference.whitening import Bins
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.reference.held_out import held_out_residual
from taxel_models.recordings import Recording

pytestmark = pytest.mark.usefixtures("quick_references")

Make = Callable[..., Recording]
Floats = NDArray[np.float64]

COMMON = 40.0
"""SD of the error that all electrodes have in common, counts; each one's own has 4."""


def errs_alike(
    recording: Recording, seed: int, *, common: float = COMMON, white: float = 0.0, opposite: bool = False
) -> Recording:
    """With an error that wanders within a second, of the electrodes together, each to its own degree.

    Args:
        white: SD of further noise of each channel, counts.
        opposite: every other electrode errs to the other side.
    """
    random = np.random.default_rng(seed)
    rows = len(recording)
    knots = random.normal(size=rows // 40 + 2)
    wander = np.interp(np.arange(rows) / 40.0, np.arange(len(knots)), knots)
    degree = np.random.default_rng(77).uniform(0.5, 1.5, 19) * common
    degree[1::2] *= -1.0 if opposite else 1.0
    counts = recording.channels + white * random.normal(size=recording.channels.shape)
    counts[:, 2:] += wander[:, None] * degree
    return replace(recording, channels=np.clip(np.rint(counts), 0, COUNTS_MAX))


def shaken(recording: Recording, seed: int) -> Recording:
    """Discharges at random moments, of the electrodes together, each to its own degree and sign."""
    random = np.random.default_rng(seed)
    struck = (random.random(len(recording)) < 0.008) * random.standard_normal(len(recording))
    decay = lfilter([1.0], [1.0, -0.97], struck)
    counts = recording.channels.copy()
    counts[:, 2:] += decay[:, None] * random.normal(size=19) * COMMON / decay.std()
    return replace(recording, channels=np.clip(np.rint(counts), 0, COUNTS_MAX))


def weaker(recording: Recording, name: str, share: float) -> Recording:
    """A channel loses a share of its signal."""
    column = CHANNELS.index(name)
    counts = recording.channels.copy()
    own = counts[:, column]
    counts[:, column] = np.rint(own - share * (own - own.mean()))
    return replace(recording, channels=counts)


def leaks(recording: Recording, source: str, to: str, share: float) -> Recording:
    """A channel gets a share of another one's signal."""
    counts = recording.channels.copy()
    own = counts[:, CHANNELS.index(source)]
    counts[:, CHANNELS.index(to)] += np.rint(share * (own - own.mean()))
    return replace(recording, channels=counts)


def leaks_in_a_chain(recording: Recording) -> Recording:
    """e10 to e12 each get a share of the signal of the electrode before."""
    counts = recording.channels.copy()
    for before, after in pairwise(CHANNELS.index(name) for name in ("e9", "e10", "e11", "e12")):
        own = recording.channels[:, before]
        counts[:, after] += np.rint(0.15 * (own - own.mean()))
    return replace(recording, channels=counts)


@pytest.fixture(scope="module")
def reference(smooth: Any, make: Make) -> HeldOutResidual:
    found = held_out_residual(smooth, [errs_alike(make(seed=8, materials=False), seed=1)])
    assert found is not None
    assert found.correlated is not None
    return found


@pytest.fixture(scope="module")
def recording(make: Make) -> Recording:
    return errs_alike(make(seed=4), seed=2)


def named(
    smooth: Any, recording: Recording, reference: HeldOutResidual | None, *other: str
) -> list[tuple[str, str]]:
    """The effects that are found, each with its form."""
    observations = gather(smooth, [recording])
    competing = "gain", "crosstalk", "offset", *other
    effects = [one for one in candidates(observations) if one.label in competing]
    found = JointSelection(observations, cut(observations, seed=0), effects, reference=reference).run()
    return [(one.name, one.candidate.form) for one in found.named]


class Searched(NamedTuple):
    """What changes of a few channels are looked for in."""

    channels: CorrelatedChannels
    left: Floats
    remaining: Remaining
    beside: NamedInChannels
    search: Callable[[Effect], FewChannelsSearch]


def searched(
    observations: Observations, known: CorrelatedResidual | None, constants: Constants = DECLARED
) -> Searched:
    """The fit part of a recording in which nothing is named."""
    assert known is not None
    blocks, left = cut(observations, seed=0), observations.residual
    channels = CorrelatedChannels(left, Bins.of(blocks, constants.bin_s), known, constants)
    remaining = Remaining(left, blocks.fit, np.ones(len(observations)))
    beside = channels.beside_named(left, [])
    search = partial(FewChannelsSearch, channels, observations, remaining, beside)
    return Searched(channels, left, remaining, beside, search)


def test_a_small_constant_shows_beside_what_all_channels_have(smooth: Any, make: Make) -> None:
    """Weighed beside a constant, nothing would be left of it."""
    known = held_out_residual(
        smooth, [errs_alike(make(seed=8, materials=False), seed=1, common=12, white=8)]
    )
    recording = errs_alike(make(seed=4), seed=2, common=12, white=8)
    changed = recording.channels.copy()
    for name, offset in {"e3": 6, "e8": -6, "e14": 6, "e17": -6}.items():
        changed[:, CHANNELS.index(name)] += offset
    offsets = replace(recording, channels=np.clip(changed, 0, COUNTS_MAX))
    assert named(smooth, offsets, known) == [("offset", "constant")]
    assert named(smooth, recording, known) == []


def test_a_channel_that_gives_more_than_it_has_is_no_leak(
    smooth: Any, recording: Recording, reference: HeldOutResidual
) -> None:
    """A leak of half is found; one of one and a half, no wire can make."""
    for share, names in ((0.5, {"crosstalk"}), (1.5, set())):
        found = named(smooth, leaks(recording, "e4", "e9", share), reference)
        leaking = {name for name, form in found if name == "crosstalk" and ": only " in form}
        assert leaking == names, found


def test_weights_are_those_of_generalised_least_squares(
    smooth: Any, recording: Recording, reference: HeldOutResidual
) -> None:
    """Of bins without correlation in time: (X' S^-1 X)^-1 X' S^-1 y, written out for all channels."""
    observations = gather(smooth, [weaker(recording, "e4", 0.3)])
    assert reference.correlated is not None
    nothing = (0.0,) * len(CHANNELS)
    white = reference.correlated.model_copy(update={"shared": nothing, "fading": nothing})
    channels, left, _, beside, search = searched(observations, white, replace(DECLARED, robust=1e9))
    bins = channels.bins
    best = search(Gain()).best()
    assert best is not None
    assert best.form.channels == [CHANNELS.index("e4")]
    found = channels.weights(best.form, beside, UNSHRUNK)[0]
    column = CHANNELS.index("e4")
    assert np.flatnonzero(found.any(axis=1)).tolist() == [column]

    precision = np.array(white.precision)
    own = bins.of_basis(best.form.candidate.basis)[column]
    # The constants' prior is as wide as the channel's error, so that it hardly counts over all bins.
    target = bins.means(left.T[:, :, None])[:, :, 0]
    target = target - target.mean(axis=1, keepdims=True)
    own = own - own.mean(axis=0)
    gram = precision[column, column] * own.T @ own
    cross = own.T @ (precision @ target)[column]
    np.testing.assert_allclose(found[column], np.linalg.solve(gram, cross), rtol=0.02)


def test_a_change_of_one_electrode_stands_out_from_errors_that_all_have(
    smooth: Any, recording: Recording, reference: HeldOutResidual
) -> None:
    dying = weaker(recording, "e4", 0.25)
    ((name, form),) = named(smooth, dying, reference)
    assert name == "gain"
    assert "only e4" in form
    alone = reference.model_copy(update={"correlated": None})
    assert named(smooth, dying, alone) == []


def test_a_gain_of_all_electrodes_is_no_less_one_because_more_than_a_few_show_it(
    smooth: Any, recording: Recording, reference: HeldOutResidual
) -> None:
    """By itself it is less than 3 % of the error, so that it must show beside all others."""
    gains = np.random.default_rng(6).uniform(-0.3, 0.3, len(CHANNELS))
    gains[:2] = 0.0
    about = recording.channels - recording.channels.mean(axis=0)
    changed = replace(recording, channels=np.rint(recording.channels + gains * about))
    assert [name for name, _ in named(smooth, changed, reference)] == ["gain"]


def test_an_electrode_that_fades_where_the_others_err_otherwise_than_usual_follows_the_prediction(
    smooth: Any, make: Make, reference: HeldOutResidual, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = errs_alike(make(12_000, seed=4), seed=2, opposite=True)
    column = CHANNELS.index("e4")
    own = recording.channels[:, column]
    counts = recording.channels.copy()
    counts[:, column] = np.rint(own - np.linspace(0.0, 0.8, len(own)) * (own - own.mean()))
    observations = gather(smooth, [replace(recording, channels=counts)])
    channels, _, remaining, _, search = searched(observations, reference.correlated)
    best = search(Gain()).best()
    assert best is not None
    assert best.form.channels == [column]
    foretold, _ = channels.signals(Gain(), observations, remaining)
    monkeypatch.setattr(channels, "signals", lambda *_: [foretold])
    assert search(Gain()).best() is None


@pytest.mark.parametrize(
    ("rows", "white", "found"), [(6_000, 4.0, ("e10", "e11", "e12")), (3_000, 15.0, ("e11",))]
)
def test_leaks_from_one_electrode_to_the_next_are_found_together(
    smooth: Any, make: Make, reference: HeldOutResidual, rows: int, white: float, found: tuple[str, ...]
) -> None:
    """Each hides its neighbours, which foretell most of it; together they stand out."""
    recording = leaks_in_a_chain(errs_alike(make(rows, seed=4), seed=2, white=white))
    best = searched(gather(smooth, [recording]), reference.correlated).search(Crosstalk()).best()
    assert best is not None
    assert [CHANNELS[channel] for channel in best.form.channels] == list(found)
    # Those that join were chosen among all electrodes.
    assert best.chance == (1.0 if len(found) == 1 else 1 / 19)


def test_what_is_usual_of_a_leak_is_what_it_adds_to_others(
    smooth: Any, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alone, a channel shows less of a chain of leaks that the model has from the start."""
    begun = leaks_in_a_chain(errs_alike(make(seed=8, materials=False), seed=1, opposite=True))

    def usual() -> dict[str, Floats]:
        known = held_out_residual(smooth, [begun])
        assert known is not None
        assert known.correlated is not None
        own = known.correlated.structure["crosstalk"]
        return {"odds": np.array(own.log_evidence), "gain": np.array(own.gain)}

    beside = usual()
    monkeypatch.setattr(FewChannelsSearch, "added", lambda *_: iter(()))
    alone = usual()
    column = CHANNELS.index("e12")
    for name in ("odds", "gain"):
        assert (beside[name] >= alone[name]).all()
        assert beside[name][column] > 1.2 * alone[name][column]


def test_a_disturbed_part_hides_no_source(
    smooth: Any, recording: Recording, reference: HeldOutResidual
) -> None:
    """Another channel reads far too much for 5 s, and others foretell of it what does not come."""
    counts, source, channel = recording.channels.copy(), CHANNELS.index("e9"), CHANNELS.index("e10")
    own = recording.channels[:, source]
    counts[:, channel] += np.rint(0.1 * (own - own.mean()))
    counts[1_000:1_500, CHANNELS.index("e14")] += 1500
    observations = gather(smooth, [replace(recording, channels=np.clip(counts, 0, COUNTS_MAX))])
    given = searched(observations, reference.correlated)
    (signals,) = given.channels.signals(Crosstalk(), observations, given.remaining)
    assert signals.about_mean.candidates[0].sources[channel] == CHANNELS[source]


def test_electrodes_that_age_each_in_its_own_way_are_put_right(
    smooth: Any, make: Make, reference: HeldOutResidual
) -> None:
    """A straight fade and a step have other pieces of the session's time, and one form that holds both."""
    recording = errs_alike(make(12_000, seed=4), seed=2)
    time = np.linspace(0.0, 1.0, len(recording))
    lost = np.zeros(recording.channels.shape)
    columns = [CHANNELS.index(name) for name in ("e4", "e9")]
    lost[:, columns] = np.column_stack([0.7 * time, 0.5 * (time > 0.4)])
    about = recording.channels - recording.channels.mean(axis=0)
    changed = replace(recording, channels=np.rint(recording.channels - lost * about))
    observations = gather(smooth, [changed])
    channels, _, _, beside, search = searched(observations, reference.correlated)
    best = search(Gain()).best()
    assert best is not None
    assert best.form.channels == columns
    weights = channels.weights(best.form, beside, UNSHRUNK)[0]
    found = best.form.candidate.basis.times(weights)[:, columns]
    rows = observations.rows[0]
    true = (changed.channels - recording.channels)[rows][:, columns]
    off = (found - found.mean(axis=0)) - (true - true.mean(axis=0))
    assert (off.std(axis=0) < 0.35 * true.std(axis=0)).all(), off.std(axis=0) / true.std(axis=0)


@pytest.mark.parametrize("spread", [0.04, 0.08])
def test_gains_of_kinds_are_no_rival_of_a_gain_that_they_contain(
    smooth: Any, recording: Recording, reference: HeldOutResidual, spread: float
) -> None:
    """Each material has a little gain of its own, and one electrode a larger one on all of them."""
    gains = np.random.default_rng(6).normal(size=(6, 21)) * spread
    kinds = recording.covariates["material"].astype(int)
    about = recording.channels - recording.channels.mean(axis=0)
    other = replace(recording, channels=np.rint(recording.channels + gains[kinds] * about))
    found = named(smooth, weaker(other, "e9", 0.2), reference, "covariate:material")
    assert any(name == "gain" and "e9" in form and ": only " in form for name, form in found)


@pytest.mark.parametrize(
    "seed", [7, pytest.param(8, marks=pytest.mark.long), pytest.param(9, marks=pytest.mark.long)]
)
def test_an_electrode_is_weighed_beside_what_a_named_effect_may_be_in_it(
    smooth: Any, recording: Recording, reference: HeldOutResidual, seed: int
) -> None:
    """Creep takes what it can of a weaker electrode, and what it leaves of it looks as if it aged."""
    force = np.linalg.norm(recording.samples.force, axis=1)
    low_passed = lfilter([0.01], [1.0, -0.99], force)[:, None]
    crept = recording.channels + low_passed * np.random.default_rng(seed).normal(size=21) * 30.0
    changed = weaker(replace(recording, channels=np.rint(crept)), "e4", 0.3)
    (creep, _), gain = named(smooth, changed, reference, "creep", "load")
    assert creep == "creep"
    assert gain == ("gain", "by channel: only e4")


def test_what_one_electrode_shows_by_itself_alone_is_left(
    smooth: Any, recording: Recording, reference: HeldOutResidual
) -> None:
    """Where it is usual beside all other channels, its own error is no proof."""
    changed = weaker(recording, "e9", 0.5)
    alone = reference.model_copy(update={"correlated": None})
    assert [name for name, _ in named(smooth, changed, alone)] == ["gain"]
    assert reference.correlated is not None
    structure = reference.correlated.structure | {
        "gain": OwnStructure(log_evidence=(0.0,) * 21, gain=(1e3,) * 21)
    }
    beside = reference.correlated.model_copy(update={"structure": structure})
    assert named(smooth, changed, reference.model_copy(update={"correlated": beside})) == []


def test_a_leak_is_told_from_the_measured_signal_of_its_source(
    smooth: Any, recording: Recording, reference: HeldOutResidual
) -> None:
    (name, form), *_ = named(smooth, leaks(recording, "e8", "e9", 0.25), reference)
    assert name == "crosstalk"
    assert "only e9" in form


def test_nothing_is_named_where_nothing_changed(
    smooth: Any, make: Make, reference: HeldOutResidual
) -> None:
    for seed in (4, 5, 6):
        assert named(smooth, errs_alike(make(seed=seed), seed=seed), reference) == []


def test_the_reference_says_what_each_kind_of_effect_explains(reference: HeldOutResidual) -> None:
    assert Drift.follows is None
    assert reference.correlated is not None
    structure = reference.correlated.structure
    assert {Gain.name, Crosstalk.name, Drift.name, "creep", "rate"} <= set(structure)
    # What one channel alone gains is known of those that change few.
    assert {name for name, own in structure.items() if any(own.gain)} == {Gain.name, Crosstalk.name}


def test_what_the_others_foretell_leaves_little(
    smooth: Any, recording: Recording, reference: HeldOutResidual
) -> None:
    observations: Observations = gather(smooth, [recording])
    bins = Bins.of(cut(observations, seed=0), DECLARED.bin_s)
    assert reference.correlated is not None
    channels = CorrelatedChannels(observations.residual, bins, reference.correlated, DECLARED)
    left = channels.conditional_residual(observations.residual)[:, 2:].std(axis=0)
    assert (left < 0.5 * observations.residual[:, 2:].std(axis=0)).all()


@pytest.mark.parametrize("hertz", [0.7, 3.0])
def test_a_cause_that_all_channels_have_is_no_leak(
    smooth: Any, recording: Recording, reference: HeldOutResidual, hertz: float
) -> None:
    """Each channel follows its neighbours then, and each other's measured signals."""
    random = np.random.default_rng(6)
    wave = np.sin(2 * np.pi * hertz * np.arange(len(recording)) / 100.0)[:, None]
    counts = np.rint(recording.channels + wave * random.normal(size=21) * COMMON)
    assert named(smooth, replace(recording, channels=counts), reference) == []


@pytest.mark.parametrize("seed", [3, 14, 22])
def test_what_shakes_all_channels_is_no_change_of_a_few(
    smooth: Any, recording: Recording, reference: HeldOutResidual, seed: int
) -> None:
    """Each channel follows the others, but not what the model gives of them."""
    found = named(smooth, shaken(recording, seed), reference)
    assert not [form for _, form in found if ": only " in form]


@pytest.mark.parametrize(("drifts", "rises"), [(10.0, True), (0.0, False)])
def test_an_effect_of_many_channels_tells_what_it_removes_of_held_out_blocks(
    smooth: Any, recording: Recording, reference: HeldOutResidual, drifts: float, rises: bool
) -> None:
    """Less than nothing where it is not there: weights that are fitted to noise make other blocks worse."""
    age = np.linspace(-1.0, 1.0, len(recording))[:, None]
    added = drifts * age * np.random.default_rng(7).normal(size=21)
    observations = gather(smooth, [replace(recording, channels=np.rint(recording.channels + added))])
    channels, _, remaining, beside, _ = searched(observations, reference.correlated)
    forms = list(Drift().forms(observations, remaining))
    found = channels.of_many("drift", forms, beside.bases(()))
    assert (found.gain > found.log_evidence > 0) if rises else found.gain <= 0


def test_an_effect_of_many_channels_that_is_likelier_goes_first(
    smooth: Any, recording: Recording, reference: HeldOutResidual
) -> None:
    random = np.random.default_rng(7)
    age = np.linspace(-1.0, 1.0, len(recording))[:, None]
    counts = np.rint(recording.channels + age * random.normal(size=21) * 10.0)
    observations = gather(smooth, [replace(recording, channels=counts)])
    found = JointSelection(
        observations, cut(observations, seed=0), candidates(observations), reference=reference
    ).run()
    assert [one.name for one in found.named] == ["drift"]


def test_what_all_channels_show_together_anyway_is_no_evidence(
    smooth: Any, recording: Recording, reference: HeldOutResidual
) -> None:
    counts = recording.channels + np.linspace(-200, 200, len(recording))[:, None]
    drifting = replace(recording, channels=np.clip(np.rint(counts), 0, COUNTS_MAX))
    assert reference.correlated is not None
    often = OwnStructure(log_evidence=(1e3,) * len(CHANNELS), gain=(0.0,) * len(CHANNELS))
    structure = {**reference.correlated.structure, "drift": often}
    usual = reference.correlated.model_copy(update={"structure": structure})
    assert named(smooth, drifting, reference, "drift")[0][0] == "drift"
    known = reference.model_copy(update={"correlated": usual})
    found = named(smooth, drifting, known, "drift")
    assert "drift" not in [name for name, _ in found]
    # Where the user asks for what the model lacked from the start, too, nothing is usual.
    settings = LoopSettings(reference=False, stability=0)
    effects = run_loop(smooth, [drifting], settings, reference=known).findings.effects
    assert "drift" in [effect.name for effect in effects]


def test_a_precision_without_all_channels_is_refused(reference: HeldOutResidual) -> None:
    assert reference.correlated is not None
    damaged = reference.correlated.model_dump()
    damaged["precision"] = damaged["precision"][:3]
    with pytest.raises(ValidationError, match="at least 21 items"):
        CorrelatedResidual(**damaged)
