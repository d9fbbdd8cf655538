"""From an XGBoost JSON model file to a Forest."""

import json
import re
from collections.abc import Sequence
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from taxel.errors import ArtifactError
from taxel_server.runtimes.trees.reading.forest import Forest
from taxel_server.runtimes.trees.reading.schema import LearnerParam, Model, NamedModel, Tree

_PER_NODE: Final = ("left_children", "right_children", "split_indices", "default_left", "split_type")

_NOT_JSON: Final = re.compile(rb"-?Infinity|NaN")
"""Numbers that XGBoost writes although JSON does not have them."""

_BEYOND_FLOAT32: Final = {b"Infinity": b"1e39", b"-Infinity": b"-1e39", b"NaN": b"null"}

_MOST_OUTPUTS: Final = 4096

_NUMBERS: Final = msgspec.json.Decoder(list[float])


def read_forest(path: Path) -> Forest:
    """Reads what `Booster.save_model("….json")` of XGBoost 3 wrote.

    Raises:
        ArtifactError: the file is damaged, or it needs something that is not supported; the text
            names the file, the place and what was expected there.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read: {error}") from error
    if b"Infinity" in text or b"NaN" in text:
        text = _NOT_JSON.sub(lambda found: _BEYOND_FLOAT32[found[0]], text)
    try:
        learner = _decoded(text).learner
        model, param = learner.gradient_booster.model, learner.learner_model_param
        base_score = _base_score(param)
        outputs = np.array(model.tree_info, dtype=np.int32)
        _check_outputs(outputs, len(model.trees), len(base_score))
        return _forest(model.trees, outputs, base_score, int(param.num_feature))
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from error


def _decoded(text: bytes) -> Model:
    try:
        return msgspec.json.decode(text, type=Model)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ArtifactError(_unsupported_part(text) or str(error)) from error


def _unsupported_part(text: bytes) -> str:
    """The booster or objective that is not supported: it explains other differences from the schema."""
    try:
        learner = msgspec.json.decode(text, type=NamedModel).learner
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return ""
    booster, objective = learner.gradient_booster.name, learner.objective.name
    if booster != "gbtree":
        return f"learner.gradient_booster.name: expected 'gbtree', found {booster[:60]!r}"
    if objective not in ("reg:squarederror", "reg:absoluteerror"):
        known = "'reg:squarederror' or 'reg:absoluteerror'"
        return f"learner.objective.name: expected {known}, found {objective[:60]!r}"
    return ""


def _forest(
    trees: Sequence[Tree], outputs: NDArray[np.int32], base_score: NDArray[np.float32], features: int
) -> Forest:
    sizes = [int(tree.tree_param.num_nodes) for tree in trees]
    total = sum(sizes)
    thresholds = [_numbers(number, tree.split_conditions) for number, tree in enumerate(trees)]
    for name in _PER_NODE:
        _check_lengths(name, [len(getattr(tree, name)) for tree in trees], sizes)
    _check_lengths("split_conditions", [len(each) for each in thresholds], sizes)

    def joined(name: str) -> NDArray[np.int32]:
        every = chain.from_iterable(getattr(tree, name) for tree in trees)
        return np.fromiter(every, np.int32, total)

    if joined("split_type").any():
        raise ArtifactError("split_type names a categorical split: only numerical splits are supported")
    forest = Forest(
        features=features,
        base_score=base_score,
        roots=np.cumsum([0, *sizes]),
        outputs=outputs,
        right=joined("right_children"),
        feature=joined("split_indices"),
        default_left=joined("default_left") != 0,
        value=_rounded(np.fromiter(chain.from_iterable(thresholds), np.float64, total), trees, sizes),
    )
    return forest.in_preorder(joined("left_children"))


def _numbers(tree: int, text: msgspec.Raw) -> list[float]:
    try:
        return _NUMBERS.decode(text)
    except msgspec.MsgspecError as error:
        raise ArtifactError(f"tree {tree}: split_conditions: {error}") from error


def _check_lengths(name: str, lengths: list[int], sizes: list[int]) -> None:
    for tree, (length, size) in enumerate(zip(lengths, sizes, strict=True)):
        if length != size:
            raise ArtifactError(f"tree {tree}: {name} has {length} entries: expected {size}")


def _rounded(
    values: NDArray[np.float64], trees: Sequence[Tree], sizes: Sequence[int]
) -> NDArray[np.float32]:
    """The decimals of the trees' `split_conditions`, rounded once to float32, from their float64.

    If a float64 lies in the middle of two float32, its own rounding may have hidden on which side the
    decimal is. Only then the decimal itself is compared.
    """
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        result = values.astype(np.float32)
        beyond = np.where(values > result, np.float32(np.inf), np.float32(-np.inf))
        middle = values - result == np.nextafter(result, beyond) - values
    starts = np.cumsum([0, *sizes])
    for node in np.flatnonzero(middle).tolist():
        tree = int(np.searchsorted(starts, node, side="right")) - 1
        decimals = bytes(trees[tree].split_conditions).strip(b" \t\r\n[]").split(b",")
        hidden = Fraction(decimals[node - int(starts[tree])].decode()) - Fraction(values[node])
        if hidden:
            result[node] = np.nextafter(values[node], np.inf if hidden > 0 else -np.inf)
    return result


def _base_score(param: LearnerParam) -> NDArray[np.float32]:
    """One score for each output. XGBoost before 3.1 wrote a single number for all outputs."""
    text, targets = param.base_score, int(param.num_target)
    if targets > _MOST_OUTPUTS:
        raise ArtifactError(f"num_target is {targets}: expected at most {_MOST_OUTPUTS}")
    try:
        scores = np.atleast_1d(np.asarray(json.loads(text), dtype=np.float32))
    except (ValueError, TypeError) as error:
        raise ArtifactError(f"base_score is {text!r}: expected a number or a list of numbers") from error
    if scores.ndim != 1 or len(scores) not in (1, targets) or not np.isfinite(scores).all():
        raise ArtifactError(f"base_score is {text!r}: expected {targets} finite numbers")
    return np.broadcast_to(scores, targets).copy()


def _check_outputs(outputs: NDArray[np.int32], trees: int, targets: int) -> None:
    if len(outputs) != trees:
        raise ArtifactError(f"tree_info has {len(outputs)} entries: expected one for each of {trees} trees")
    if not 0 <= outputs.min() <= outputs.max() < targets:
        raise ArtifactError(f"tree_info names outputs {outputs.min()} to {outputs.max()} of {targets}")
