"""Which of several scores is chosen, where no recording is needed to tell."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from taxel_models.loop.attribution import in_order
from taxel_models.loop.effects.effect import Fitting
from taxel_models.loop.inference.choice import casts_doubt, choose
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.selection import JointSelection


@pytest.mark.parametrize(
    ("t", "with_usual", "worth", "doubt"),
    [(2.0, 2.5, 0.1, True), (2.0, 4.0, 0.1, False), (4.0, 5.0, 0.1, False), (2.0, 2.5, -0.1, False)],
)
def test_what_the_model_gets_wrong_anyway_and_what_takes_nothing_off_are_no_doubt(
    t: float, with_usual: float, worth: float, doubt: bool
) -> None:
    def score(evidence: float, t: float, with_usual: float, worth: float) -> Any:
        return SimpleNamespace(
            form=SimpleNamespace(candidate=SimpleNamespace(fitting=Fitting())),
            freedom=21,
            folds=8,
            log_evidence=evidence,
            t=t,
            t_with_usual=with_usual,
            worth=np.full(21, worth),
        )

    best, likelier = score(100.0, 6.0, 8.0, 0.2), score(200.0, t, with_usual, worth)
    assert casts_doubt(likelier, best, DECLARED) is doubt


@pytest.mark.parametrize("has_constant", [True, False])
def test_a_constant_is_named_where_the_likeliest_effect_is_in_doubt(has_constant: bool) -> None:
    def score(name: str, evidence: float, repeats: bool) -> Any:
        form = SimpleNamespace(candidate=SimpleNamespace(certain=False, fitting=Fitting()))
        effect = SimpleNamespace(is_constant=name == "offset")
        t = 6.0 if repeats else 2.0
        return SimpleNamespace(
            form=form,
            effect=effect,
            freedom=21,
            folds=8,
            log_evidence=evidence,
            t_with_usual=t,
            worth=np.full(21, 0.1),
        )

    gain, saturation, offset = (
        score("gain", 300.0, False),
        score("saturation", 200.0, True),
        score("offset", 100.0, True),
    )
    able = [saturation, offset] if has_constant else [saturation]
    assert choose(able, [gain, *able], DECLARED) is (offset if has_constant else None)


@pytest.mark.parametrize(("worth", "named"), [(0.1, "offset:contact"), (0.19, "gain")])
def test_offsets_of_contacts_do_not_stand_for_a_drift_that_is_not_proven(worth: float, named: str) -> None:
    """They contain it. The next one that proves itself may be named."""

    def score(name: str, evidence: float, worth: float) -> Any:
        effect = SimpleNamespace(
            is_constant=False, is_predictable=name != "offset:contact", is_steady=name == "drift"
        )
        candidate = SimpleNamespace(certain=False, fitting=Fitting(few_channels=name == "gain"))
        return SimpleNamespace(
            name=name,
            form=SimpleNamespace(candidate=candidate),
            effect=effect,
            freedom=21,
            folds=8,
            log_evidence=evidence,
            t_with_usual=6.0,
            worth=np.full(21, worth),
            needs_constant=False,
        )

    contacts, drift, gain = (
        score("offset:contact", 300.0, 0.2),
        score("drift", 200.0, worth),
        score("gain", 100.0, 0.05),
    )
    chosen = choose([contacts, gain], [contacts, drift, gain], DECLARED)
    assert chosen is not None
    assert chosen.name == named


def test_a_likelier_constant_is_named_before_changes_of_a_few_channels() -> None:
    """They have fewer figures, and their gain is on another scale."""

    def score(name: str, evidence: float, freedom: int, gain: float) -> Any:
        fitting = Fitting(few_channels=name == "gain")
        form = SimpleNamespace(candidate=SimpleNamespace(certain=False, fitting=fitting))
        effect = SimpleNamespace(is_constant=name == "offset", is_predictable=True)
        return SimpleNamespace(
            form=form,
            effect=effect,
            freedom=freedom,
            log_evidence=evidence,
            needs_constant=name == "gain",
            total_gain=gain,
            evidence_within=lambda figures: evidence if freedom <= figures else -np.inf,
        )

    offset, gain = score("offset", 300.0, 21, 500.0), score("gain", 200.0, 1, 900.0)
    assert choose([offset, gain], [], DECLARED) is offset
    likelier = score("gain", 700.0, 1, 900.0)
    assert choose([likelier, offset], [], DECLARED) is likelier


def test_a_fault_comes_before_what_explains_less() -> None:
    def one(name: str, conditional: float) -> Any:
        return SimpleNamespace(name=name, conditional=conditional)

    named = [one("fault", 0.2), one("interference", 0.05), one("gain", 0.3), one("rate", 0.1)]
    # Others stay in their order: a line of the spectrum stands by itself.
    assert [each.name for each in in_order(named)] == ["interference", "gain", "fault", "rate"]
    assert [each.name for each in in_order(named[:2])] == ["fault", "interference"]


@pytest.mark.parametrize(
    ("conditional", "expected"),
    [
        ((0.1, 0.4, 0.05), ["gain", "offset", "rate"]),
        ((0.1, 0.05, 0.4), ["gain", "rate", "offset"]),
        ((0.4, 0.1, 0.05), ["offset", "gain", "rate"]),
    ],
)
def test_a_constant_comes_behind_what_explains_more(
    conditional: tuple[float, ...], expected: list[str]
) -> None:
    names = ("offset", "gain", "rate")
    named: Any = [
        SimpleNamespace(name=name, conditional=own) for name, own in zip(names, conditional, strict=True)
    ]
    assert [each.name for each in in_order(named)] == expected
    # It is never put before what was found first.
    assert in_order([named[1], named[0]])[0].name == "gain"


def in_a_place(
    name: str, log_evidence: float, freedom: int, *, constant: bool = False, needs_constant: bool = False
) -> Any:
    """A score that another one may replace, or that may replace another one."""
    return SimpleNamespace(
        name=name,
        effect=SimpleNamespace(is_predictable=True, is_constant=constant),
        form=SimpleNamespace(candidate=SimpleNamespace(moves=False)),
        freedom=freedom,
        log_evidence=log_evidence,
        needs_constant=needs_constant,
    )


@pytest.mark.parametrize(
    ("evidence", "freedom", "constant", "proven", "replaced"),
    [
        pytest.param(200.0, 300, False, False, True, id="likelier"),
        pytest.param(60.0, 21, False, True, True, id="simpler, chosen of two that prove themselves"),
        pytest.param(60.0, 21, False, False, False, id="simpler, but the named one was no choice"),
        pytest.param(
            60.0, 21, True, True, False, id="a constant, which stands beside the named one anyway"
        ),
        pytest.param(60.0, 300, False, True, False, id="neither"),
    ],
)
def test_a_named_effect_gives_way_to_a_likelier_or_a_simpler_one(
    evidence: float, freedom: int, constant: bool, proven: bool, replaced: bool
) -> None:
    own = in_a_place("named", 100.0, 294)
    other = in_a_place("other", evidence, freedom, constant=constant)
    selection: Any = SimpleNamespace(proves_itself=lambda *_: proven)
    assert JointSelection._replaces(selection, other, own) is replaced
    assert not JointSelection._replaces(selection, own, own)
    assert not JointSelection._replaces(selection, other, None)


@pytest.mark.parametrize("needs_constant", [True, False])
def test_what_needs_a_constant_beside_it_does_not_take_a_constants_place(needs_constant: bool) -> None:
    """A skin that contact warms within seconds is nearly as steady, with one figure in place of 21."""

    own = in_a_place("offset", 100.0, 21, constant=True)
    other = in_a_place("temperature", 130.0, 1, needs_constant=needs_constant)
    selection: Any = SimpleNamespace(proves_itself=lambda *_: True)
    assert JointSelection._replaces(selection, other, own) is not needs_constant


def test_a_simpler_effect_is_asked_whether_it_is_mostly_a_constant() -> None:
    """Kinds that need a constant beside them are mostly that; a gain of all channels is not."""

    def score(name: str, evidence: float, freedom: int, gain: float, alone: float) -> Any:
        return SimpleNamespace(
            form=SimpleNamespace(candidate=SimpleNamespace(certain=False, fitting=Fitting())),
            effect=SimpleNamespace(is_constant=name == "offset", is_predictable=True),
            freedom=freedom,
            log_evidence=evidence,
            log_evidence_alone=alone,
            needs_constant=name != "offset",
            total_gain=gain,
            worth=np.full(21, 0.1),
            evidence_within=lambda figures: evidence if freedom <= figures else -np.inf,
        )

    kinds, gain = score("covariate", 801.0, 126, 290.0, 700.0), score("gain", 800.0, 1, 600.0, 750.0)
    offset = score("offset", 430.0, 21, 500.0, 430.0)
    assert choose([kinds, gain, offset], [], DECLARED) is gain
    assert choose([kinds, offset], [], DECLARED) is offset
