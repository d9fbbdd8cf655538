"""What stands around the layers: a damaged one is refused, by its place in the file."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Change = Callable[[Any], None]
Refusal = Callable[[Path], str]


def set_in(keys: tuple[Any, ...], value: Any) -> Change:
    def change(model: Any) -> None:
        place = model.content
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value

    return change


FRAME: dict[str, tuple[Change, str]] = {
    "no weights": (lambda model: model.content.pop("weights"), "weights: Field required"),
    "no layers": (set_in(("layers", "layers"), []), "layers: layers: List should have at least 1"),
    "too many layers": (
        set_in(("layers", "layers"), [{}] * 513),
        "layers: layers: List should have at most 512",
    ),
    "two outputs": (
        set_in(("layers", "output_layers"), [["sum", 0, 0], ["warm_out", 0, 0]]),
        "layers: output_layers",
    ),
    "unknown output": (
        set_in(("layers", "output_layers"), [["end", 0, 0]]),
        "output layer 'end': not among",
    ),
    "narrow output": (
        set_in(("layers", "output_layers"), [["trunk_in", 0, 0]]),
        "output layer 'trunk_in': gives 9 values: expected 23",
    ),
    "input that is none": (set_in(("layers", "input_layers"), [["sum", 0, 0]]), "input layer 'sum'"),
    "short mean": (
        lambda model: model.content["normalization"]["input"]["center"].pop(),
        "normalization: input.center",
    ),
    "a thousand faults": (
        set_in(("normalization", "input", "center"), ["x"] * 1000),
        "normalization: input.center",
    ),
    "deviation of zero": (
        set_in(("normalization", "output", "scale", 4), 0.0),
        "normalization: output.scale.4",
    ),
    "mean not finite": (
        set_in(("normalization", "input", "center", 2), float("nan")),
        "normalization: input.center.2",
    ),
}


@pytest.mark.parametrize("damage", FRAME)
def test_a_damaged_frame(model: Any, tmp_path: Path, damage: str, refusal: Refusal) -> None:
    change, match = FRAME[damage]
    change(model)
    assert re.search(match, refusal(model.write(tmp_path)))
