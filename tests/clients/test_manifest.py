"""What a manifest may say of a model's held-out residual."""

from typing import Any

import pytest
from pydantic import ValidationError

from taxel.held_out_residual import HeldOutResidual

ONES = [1.0] * 21
GOOD = {
    "rows": 9,
    "std": ONES,
    "shared": ONES,
    "fading": ONES,
    "structure": {"creep": {"log_evidence": ONES, "gain": ONES}},
}


@pytest.mark.parametrize(
    "wrong",
    [
        {"std": ONES[1:]},
        {"shared": [*ONES, 1.0]},
        {"fading": [-1.0, *ONES[1:]]},
        {"structure": {"creep": {"log_evidence": ONES, "gain": []}}},
        {"rows": 0},
    ],
)
def test_it_has_one_number_for_each_channel(wrong: dict[str, Any]) -> None:
    assert HeldOutResidual.model_validate(GOOD).structure["creep"].gain == (1.0,) * 21
    with pytest.raises(ValidationError):
        HeldOutResidual.model_validate(GOOD | wrong)
