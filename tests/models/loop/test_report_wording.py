"""Findings in words."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from taxel.corrections import CALIBRATION_AGE, CALIBRATION_EXTRAS, Parameter
from taxel.windows import Elapsed, ExtraFeature, Relaxation
from taxel_models.loop.attribution import AS_USUAL
from taxel_models.loop.findings import (
    ChannelGain,
    Findings,
    FoundEffect,
    FoundResidualModel,
    NextRecording,
    PairedTest,
    RejectedEffect,
    RunsAlong,
    Unexplained,
)
from taxel_models.loop.report.contents import SECTIONS, Told
from taxel_models.loop.report.document import Note
from taxel_models.loop.report.numbers import (
    chance,
    key_parameters,
    needs,
    number,
    parameter,
)
from taxel_models.loop.report.table import findings_table
from taxel_models.loop.report.wording import (
    beside_training,
    confounded,
    headline,
    inverted,
    left,
    like_an_offset,
    next_recordings,
    opening,
    paired,
    runs_along,
    unconfirmed_effects,
)

PAST = ExtraFeature(
    name="relaxation[2s].force", unit="N", history=Relaxation(of="force", time_constant_s=2.0)
)
HEAT = ExtraFeature(name="tdc", unit="counts", default=1900.0)


def effect(
    name: str, *confounded_with: str, needed: tuple[str, ...] = (), served: bool = True
) -> FoundEffect:
    return FoundEffect(
        name=name,
        form="line",
        equation="delta_c = w_c",
        channels=("e1",),
        explained=0.25,
        conditional=0.2,
        p_value=0.005,
        parameters=(
            Parameter(name="slope e1", value=1.5, unit="counts/s", low=1.0, high=2.0),
            Parameter(name="slope e2", value=-9.0, unit="counts/s", low=-10.0, high=-8.0),
            Parameter(name="time_constant", value=2.0, unit="s"),
            Parameter(name="slope e3", value=0.1, unit="counts/s", low=0.0, high=0.2),
        ),
        confounded_with=confounded_with,
        needs=needed,
        served=served,
    )


def findings(*effects: FoundEffect, p_value: float = 0.0001) -> Findings:
    errors = {"mae": 10.0, "norm_mae": 0.2, "rows": 900}
    return Findings(
        model="hand/1",
        data=(),
        split={},
        noise_floor={"norm_mae": 0.05, "share_of_residual_energy": 0.1},
        effects=effects,
        rejected=(RejectedEffect(name="lag", form="10 ms", alone=0.0, left=0.0, p_value=1.0, reason="no"),),
        before=errors,
        after={**errors, "mae": 5.0, "norm_mae": 0.1},
        test=PairedTest(blocks=9, difference=0.1, low=0.05, high=0.15, t=4.0, p_value=p_value),
        unexplained=Unexplained(structured=True, hint="most in e4", share=0.6, autocorrelation={}),
    )


@given(st.floats(-1e6, 1e6).filter(lambda value: abs(value) > 1e-9))
def test_numbers_keep_three_digits(value: float) -> None:
    assert float(number(value)) == pytest.approx(value, rel=0.0051)


def test_the_session_s_time_is_told_once() -> None:
    pieces = [
        ExtraFeature(
            name=f"elapsed[{start}:{start + 9}s]", unit="s", history=Elapsed(start_s=start, end_s=start + 9)
        )
        for start in (0, 9, 18)
    ]
    told = needs(effect("drift", needed=tuple(piece.name for piece in pieces)), pieces)
    assert told == "needs the session's time, which the window builder computes from past samples"


def test_the_error_is_compared_with_that_in_training() -> None:
    assert beside_training(findings()) == []
    known = findings().model_copy(update={"error_ratio": {"e1": 1.1, "e2": 0.9, "e3": 4.0, "e4": 1.0}})
    (told,) = beside_training(known)
    assert told.startswith(
        "The RMS residual of the model is 1.1 times that on recordings that its training "
    )
    assert told.endswith("(median of the channels; e3 4.0 times).")
    worse = findings().model_copy(update={"error_ratio": {"e1": 2.0, "e2": 2.2, "e3": 2.1}})
    assert beside_training(worse)[0].endswith(
        " 2.1 times that on recordings that its training held out (median of the channels)."
    )


def test_a_channel_that_is_turned_round_is_said_to_be() -> None:
    gains = (
        Parameter(name="gain e8", value=-1.96, unit="relative", low=-2.1, high=-1.8),
        Parameter(name="gain e9", value=-1.1, unit="relative", low=-1.3, high=-0.9),
    )
    found = findings(effect("gain").model_copy(update={"parameters": gains}))
    assert inverted(found) == ["The signal of e8 has the wrong sign."]
    assert inverted(findings(effect("drift"))) == []


def test_chance_is_not_written_as_zero() -> None:
    assert chance(1e-9) == "p < 0.001"
    assert chance(0.0123) == "p = 0.012"


def test_a_parameter_has_its_unit_and_interval() -> None:
    first, _, settled, _ = effect("drift").parameters
    assert parameter(first) == "slope e1 1.5 counts/s (1 to 2)"
    assert parameter(settled) == "time_constant 2 s"


def test_a_parameter_that_may_be_zero_comes_behind_smaller_ones() -> None:
    unsure = Parameter(name="slope pac0", value=20.0, unit="counts/s", low=-3.0, high=43.0)
    drift = effect("drift")
    told = key_parameters(drift.model_copy(update={"parameters": (unsure, *drift.parameters)}))
    assert told.startswith("time_constant 2 s; slope e2 -9 ")
    assert told.endswith("; slope e1 1.5 counts/s (1 to 2); 2 more")


def test_key_parameters_are_what_settles_it_and_the_largest() -> None:
    assert key_parameters(effect("drift")) == (
        "time_constant 2 s; slope e2 -9 counts/s (-10 to -8); slope e1 1.5 counts/s (1 to 2); 1 more"
    )


def test_parameters_of_a_form_that_are_nothing_are_left_out() -> None:
    turned = [
        Parameter(name=axis, value=value, unit="deg")
        for axis, value in zip("xyz", (0, 0, -25), strict=True)
    ]
    assert key_parameters(effect("frame").model_copy(update={"parameters": tuple(turned)})) == (
        "z -25 deg; 2 more"
    )


def test_what_moves_together_is_said_once() -> None:
    both = findings(effect("drift", "temperature"), effect("temperature", "drift"))
    assert confounded(both) == ["drift and temperature cannot be told apart here: they move together."]
    many = findings(effect("creep", "lag", "rate"))
    assert confounded(many) == ["creep cannot be told apart here from lag and rate: they move together."]
    assert confounded(findings(effect("creep"))) == []


def test_needs_say_who_gives_what() -> None:
    extras = [PAST, HEAT, *CALIBRATION_EXTRAS, CALIBRATION_AGE]
    assert needs(effect("offset"), extras) == "needs nothing beside the window"
    assert "window builder" in needs(effect("creep", needed=(PAST.name,)), extras)
    given_by_caller = needs(effect("temperature", needed=("tdc",)), extras)
    assert given_by_caller == "needs tdc (1900 where it is not known), which the caller gives"
    calibrated = needs(effect("offset", needed=tuple(one.name for one in extras[2:])), extras)
    assert "calibration" in calibrated
    assert "caller" not in calibrated
    assert "only reported" in needs(effect("fault", served=False), extras)
    crossed = effect("fault", served=False).model_copy(update={"form": "crossed: e1 holds e2, e2 holds e1"})
    assert "put the channels in their order" in needs(crossed, extras)


def test_why_an_effect_is_only_reported_is_told() -> None:
    assert "how the finger is mounted" in needs(effect("frame", served=False), [])
    assert "whole ticks" in needs(effect("lag", served=False), [])
    assert "not known while serving" in needs(effect("interference", served=False), [])


def test_the_headline_says_what_was_added() -> None:
    unnamed = FoundResidualModel(
        about="trees",
        needs=(),
        gain=0.01,
        channels=(ChannelGain(channel="e1", folds=0.02, error=0.01, evaluation=0.01),),
    )
    both = findings(effect("drift")).model_copy(update={"residual_model": unnamed})
    assert "; with drift and a residual model added it is off by 0.100, 50 % less" in headline(both)
    alone = findings().model_copy(update={"residual_model": unnamed})
    assert "; with a residual model added it is off by 0.100, 50 % less" in headline(alone)
    assert headline(alone).endswith(", and no effect was named.")
    reported = findings(effect("fault", served=False))
    assert headline(reported).endswith("), and fault was found, which no model can add.")
    worse = unnamed.model_copy(update={"gain": -0.01})
    assert "rises by 0.0100" in opening(findings().model_copy(update={"residual_model": worse}), [])


def test_causes_that_cannot_be_simulated_are_not_said_to_have_failed() -> None:
    untold = NextRecording(causes=("frame", "drift"), can_be_simulated=False)
    (told,) = next_recordings(findings().model_copy(update={"next_recordings": (untold,)}))
    assert told.startswith("What would tell frame from drift cannot be worked out")


def test_many_needs_are_shortened() -> None:
    kinds = [ExtraFeature(name=f"material={kind}", unit="0 or 1") for kind in range(8)]
    text = needs(effect("covariate:material", needed=tuple(one.name for one in kinds)), kinds)
    assert "material=0" in text
    assert "7 more" in text


def test_the_opening_tells_what_came_of_it() -> None:
    text = opening(findings(effect("drift", "temperature")), [])
    assert "On 9 held-out blocks (900 rows), hand/1 is off by a normalised MAE of 0.200" in text
    assert "by 0.100 (5.0 counts) once corrected: 50 % less" in text
    assert "One effect was named. drift explains 25 %" in text
    assert "1 other candidate was rejected" in text
    assert "Nothing was exported yet." in text
    exported = findings(effect("drift")).model_copy(update={"exported": "hand/2"})
    assert opening(exported, []).endswith("The corrected model is hand/2.")


def test_a_fall_that_may_be_chance_is_called_so() -> None:
    unsure = findings(effect("drift"), p_value=0.2)
    assert paired(unsure.test).endswith("which may be chance")
    assert "not worth it" in opening(unsure, [])
    assert "50 % less, which may be chance (" in headline(unsure)
    assert "chance" not in headline(findings(effect("drift")))


def test_what_looks_wrong_in_the_recordings_is_told_first() -> None:
    strange = findings(effect("drift")).model_copy(update={"looks_wrong": ("lab: forces look like grams",)})
    note = next(block for block in SECTIONS[0](Told(strange, [], {})) if isinstance(block, Note))
    assert note.lines == ("What looks wrong in the recordings: lab: forces look like grams.",)


def test_nothing_that_can_be_served_is_nothing_to_add() -> None:
    text = opening(findings(effect("fault", served=False)), [])
    assert "None of this can be added to the model." in text
    assert "once corrected" not in text
    assert "Nothing was found that the model lacks." in opening(findings(), [])


def test_what_is_not_told_from_the_models_own_error_is_told_with_its_size() -> None:
    turned, small = (
        RejectedEffect(name=name, form=form, alone=alone, left=alone, p_value=0.02, reason=AS_USUAL)
        for name, form, alone in (("frame", "forces scaled", 0.13), ("load", "by force", 0.001))
    )
    told = opening(findings().model_copy(update={"rejected": (small, turned)}), [])
    assert "frame (forces scaled, 13 % by itself) and load may be there, but cannot be told" in told
    assert "Nothing was found that the model lacks" not in told
    assert "Nothing proves itself that could be added to the model." in told
    changed = findings().model_copy(update={"changes": ("e9 lost 73 % of its sensitivity.",)})
    assert "Nothing was found" not in opening(changed, [])


def test_what_raises_the_error_on_held_out_blocks_is_told() -> None:
    worse = effect("drift").model_copy(update={"explained": -4.33})
    (told,) = unconfirmed_effects(findings(worse, effect("gain")))
    assert told.startswith("drift raises the squared error on held-out blocks, by 433 %:")
    assert told.endswith("--exclude drift.")
    assert told in opening(findings(worse), [])
    cancels = effect("crosstalk").model_copy(update={"explained": 4.4})
    (told,) = unconfirmed_effects(findings(worse, cancels))
    assert "by 433 %, and crosstalk takes that off again" in told
    assert told.endswith("--exclude crosstalk.")
    # One that stands above it does not take off what it adds.
    (told,) = unconfirmed_effects(findings(cancels, worse))
    assert told.endswith("--exclude drift.")
    little = effect("drift").model_copy(update={"explained": -0.01})
    (told,) = unconfirmed_effects(findings(little))
    assert told.startswith("drift takes nothing off the squared error on held-out blocks")
    reported = effect("frame", served=False).model_copy(update={"explained": -0.57})
    (told,) = unconfirmed_effects(findings(reported))
    assert told.endswith("by 57 %: something else may stand behind it. Do not act on it.")
    assert needs(reported, []) == "is only reported"
    assert "mounted" in needs(effect("frame", served=False), [])


def test_noise_is_called_noise() -> None:
    rest = Unexplained(structured=False, hint="", share=0.0, autocorrelation={})
    quiet = findings().model_copy(update={"unexplained": rest})
    assert left(quiet) == "What is left is indistinguishable from the channels' noise."
    assert "structured but unexplained" in left(findings())


def test_a_narrow_terminal_cuts_no_name() -> None:
    console = Console(width=80)
    with console.capture() as capture:
        console.print(findings_table(findings(effect("covariate:velocity_x", "temperature", served=False))))
    assert "covariate:velocity_x (only reported)" in capture.get()


def test_the_terminal_table_tells_the_same() -> None:
    console = Console(width=160)
    with console.capture() as capture:
        console.print(findings_table(findings(effect("covariate:[bold]", "temperature", served=False))))
        console.print(findings_table(findings(effect("drift"))))
        console.print(findings_table(findings()))
    text = capture.get()
    assert "covariate:[bold] (only reported)" in text
    assert "25 %" in text
    assert "Normalised MAE 0.200 before, 0.100 after (noise: 0.050)" in text
    assert "No effect was named." in text
    assert "Normalised MAE 0.200 (noise: 0.050). Nothing was found that the model lacks." in text
    assert "Normalised MAE 0.200 (noise: 0.050). None of this can be added to the model." in text


def test_what_would_look_like_an_offset_is_told_where_one_is_named() -> None:
    along = (
        RunsAlong(quantity="friction", along="a constant", share=0.83),
        RunsAlong(quantity="warming by contact", along="a constant", share=0.3),
    )
    found = findings(effect("offset")).model_copy(update={"confounding": along})
    assert like_an_offset(found) == [
        "In these recordings, friction (83 % of it is constant) would look mostly like an offset, too."
    ]
    assert runs_along(found) == []
    assert like_an_offset(found.model_copy(update={"effects": (effect("gain"),)})) == []
    assert like_an_offset(findings(effect("offset"))) == []


def test_what_runs_along_most_is_told_and_the_others_are_counted() -> None:
    def told(pairs: int) -> list[str]:
        shares = [0.5 + 0.05 * place for place in range(pairs)]
        along = [
            RunsAlong(quantity=f"{one}{place}", along=f"{other}{place}", share=share)
            for place, share in enumerate([*shares, 0.4])
            for one, other in ("ab", "ba")
        ]
        return runs_along(findings().model_copy(update={"confounding": tuple(along)}))

    assert told(0) == []
    assert told(1) == ["In these recordings some things run along with others: a0 with b0 (50 %)."]
    assert told(5)[0].endswith(
        ": a4 with b4 (70 %), a3 with b3 (65 %), a2 with b2 (60 %), a1 with b1 (55 %) and 1 more."
    )
    assert told(7)[0].endswith("(65 %) and 3 more.")


def test_an_error_that_rises_beyond_chance_is_not_called_chance() -> None:
    """Both the change and its interval are told as a rise."""
    worse = PairedTest(blocks=9, difference=-0.28, low=-0.38, high=-0.17, t=-6.0, p_value=0.9999)
    assert paired(worse) == "the error rises by 0.2800 (95 % interval 0.1700 to 0.3800)"
