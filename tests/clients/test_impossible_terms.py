"""Terms that a manifest may not have."""

from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from taxel.corrections import Term

ONES = (1.0,) * 21
RANDOM = {
    "kind": "random_features",
    "features": [],
    "means": ONES,
    "scales": ONES,
    "limit": 3,
    "projection": [[1]] * 21,
    "phases": [0],
    "weights": [ONES],
    "constants": ONES,
}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"kind": "weighted", "shape": "unit", "features": ["fx"], "references": [], "weights": [ONES]},
            "0 v",
        ),
        (
            {
                "kind": "weighted",
                "shape": "unit",
                "features": ["one"],
                "references": [2],
                "weights": [ONES],
            },
            "0",
        ),
        (
            {
                "kind": "weighted",
                "shape": "signal",
                "features": ["fx"],
                "references": [0],
                "weights": [ONES],
            },
            "rest",
        ),
        (
            {"kind": "weighted", "shape": "unit", "features": ["fx"], "references": [0], "weights": [[1]]},
            "21",
        ),
        (
            {"kind": "weighted", "shape": "log", "features": ["fx"], "references": [0], "weights": [ONES]},
            "shape",
        ),
        (
            {"kind": "location", "centres": [[0, 0, 0]], "width": 1, "half_force": 1, "weights": []},
            "expected 1",
        ),
        ({"kind": "crosstalk", "leaks": [["e1", "e20", 1]], "rest": ONES}, "no channel 'e20'"),
        ({**RANDOM, "projection": [[1, 2]] * 21}, r"projection\[0\] has 2 values: expected 1"),
        ({**RANDOM, "features": ["fx"]}, "means has 21 values: expected 22"),
        ({**RANDOM, "weights": [ONES, ONES]}, "weights has 2 values: expected 1"),
        ({**RANDOM, "phases": [float("inf")]}, "finite"),
        ({**RANDOM, "scales": [0.0] * 21}, "greater than 0"),
        ({"kind": "fault", "channel": "tdc", "value": 1}, "no channel 'tdc'"),
        ({"kind": "fault", "channel": "e1", "value": float("nan")}, "finite"),
        ({"kind": "guess"}, "guess"),
    ],
)
def test_impossible_terms_are_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        TypeAdapter(Term).validate_python(fields)
