"""From an XGBoost JSON model file to a Forest."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from taxel.errors import ArtifactError
from taxel_server.runtimes.trees.forest import Forest
from taxel_server.runtimes.trees.scan import ScannedText
from taxel_server.runtimes.trees.schema import LearnerParam, Model, Tree

_PER_NODE: Final = (
    "left_children",
    "right_children",
    "split_indices",
    "split_conditions",
    "default_left",
    "split_type",
)


def read_forest(path: Path) -> Forest:
    """Reads what `Booster.save_model("….json")` of XGBoost 3 wrote.

    Raises:
        ArtifactError: the file is damaged, or it needs something that is not supported; the text
            names the file, the place and what was expected there.
    """
    text = ScannedText.of(path)
    try:
        learner = Model.model_validate_json(text.skeleton).learner
    except ValidationError as error:
        raise ArtifactError(f"{path}: {_first_fault(error)}") from error
    model, param = learner.gradient_booster.model, learner.learner_model_param
    try:
        base_score = _base_score(param)
        outputs = text.integers([model.tree_info[0]], "tree_info")
        _check_outputs(outputs, len(model.trees), len(base_score))
        return _forest(text, model.trees, outputs, base_score, param.num_feature).in_preorder()
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from error


def _forest(
    text: ScannedText,
    trees: Sequence[Tree],
    outputs: NDArray[np.int32],
    base_score: NDArray[np.float32],
    features: int,
) -> Forest:
    sizes = np.array([tree["tree_param"]["num_nodes"] for tree in trees], dtype=np.int64)
    arrays = {name: [tree[name][0] for tree in trees] for name in _PER_NODE}
    for name, spans in arrays.items():
        lengths = text.lengths(spans)
        wrong = np.flatnonzero(lengths != sizes)
        if wrong.size:
            tree = wrong[0]
            raise ArtifactError(f"tree {tree}: {name} has {lengths[tree]} entries: expected {sizes[tree]}")
    roots = np.concatenate([[0], np.cumsum(sizes)])
    if text.integers(arrays["split_type"], "split_type").any():
        raise ArtifactError("split_type names a categorical split: only numerical splits are supported")
    value = text.floats(arrays["split_conditions"], "split_conditions")
    wrong = np.flatnonzero(np.isnan(value))
    if wrong.size:
        tree = int(np.searchsorted(roots, wrong[0], side="right")) - 1
        raise ArtifactError(f"tree {tree}, node {wrong[0] - roots[tree]}: split_conditions is NaN")
    return Forest(
        features=features,
        base_score=base_score,
        roots=roots,
        outputs=outputs,
        left=text.integers(arrays["left_children"], "left_children"),
        right=text.integers(arrays["right_children"], "right_children"),
        feature=text.integers(arrays["split_indices"], "split_indices"),
        default_left=text.integers(arrays["default_left"], "default_left") != 0,
        value=value,
    )


def _base_score(param: LearnerParam) -> NDArray[np.float32]:
    """One score an output; XGBoost before 3.1 wrote a single number for all of them."""
    text = param.base_score
    try:
        scores = np.atleast_1d(np.asarray(json.loads(text), dtype=np.float32))
    except (ValueError, TypeError) as error:
        raise ArtifactError(f"base_score is {text!r}: expected a number or a list of numbers") from error
    if scores.ndim != 1 or len(scores) not in (1, param.num_target) or not np.isfinite(scores).all():
        raise ArtifactError(f"base_score is {text!r}: expected {param.num_target} finite numbers")
    return np.broadcast_to(scores, param.num_target).copy()


def _check_outputs(outputs: NDArray[np.int32], trees: int, targets: int) -> None:
    if len(outputs) != trees:
        raise ArtifactError(f"tree_info has {len(outputs)} entries: expected one for each of {trees} trees")
    if not 0 <= outputs.min() <= outputs.max() < targets:
        raise ArtifactError(f"tree_info names outputs {outputs.min()} to {outputs.max()} of {targets}")


def _first_fault(error: ValidationError) -> str:
    """One fault in words: a wrong name (of a booster, say) explains the missing fields beside it."""
    faults = error.errors(include_url=False)
    fault = next((fault for fault in faults if fault["type"] == "literal_error"), faults[0])
    where = ".".join(str(part) for part in fault["loc"])
    return f"{where}: {fault['msg']}, found {str(fault['input'])[:60]!r}"
