"""Which of a form's variants is kept."""

from types import SimpleNamespace
from typing import Any

import pytest

from taxel_models.loop.effects.effect import ABOUT_MEAN
from taxel_models.loop.inference.weighing import Option, about_mean_or_not


def option(form: str, alone: float, log_evidence: float) -> Option:
    candidate = SimpleNamespace(form=form, form_itself=form.removesuffix(ABOUT_MEAN))
    some: Any = SimpleNamespace(candidate=candidate)
    return Option(log_evidence, some, some, some, alone)


@pytest.mark.parametrize(("alone", "kept"), [(30.0, "line"), (50.0, f"line{ABOUT_MEAN}")])
def test_beside_a_constant_the_variant_is_kept_that_is_likelier_without_it(alone: float, kept: str) -> None:
    both = [option("line", 40.0, 90.0), option(f"line{ABOUT_MEAN}", alone, 95.0), option("other", 1.0, 2.0)]
    assert [one.form.candidate.form for one in about_mean_or_not(both)] == [kept, "other"]


def test_without_a_constant_both_are_kept() -> None:
    both = [option("line", 40.0, 40.0), option(f"line{ABOUT_MEAN}", 30.0, 95.0)]
    assert about_mean_or_not(both) == both
