"""Merges the XGBoost models of all channels into a single model with as many outputs, without loss.

Trees of one channel keep their order, so the float32 sums stay the same to the bit:
iteration k of the merged model holds tree k of every channel that has one.
"""

import json
from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

import xgboost

from taxel.errors import ArtifactError


def merge(boosters: Sequence[xgboost.Booster]) -> bytes:
    """The XGBoost JSON of a model whose output c is `boosters[c]`.

    Raises:
        ArtifactError: the models differ in more than their trees and base scores.
    """
    models = [json.loads(booster.save_raw("json")) for booster in boosters]
    merged = models[0]
    learner = merged["learner"]
    for number, model in enumerate(models):
        _check_alike(number, learner, model["learner"])
    own_trees = [_trees(model) for model in models]
    iterations = [
        [(channel, tree) for channel, tree in enumerate(trees) if tree is not None]
        for trees in zip_longest(*own_trees)
    ]
    placed = [pair for iteration in iterations for pair in iteration]
    indptr = [0]
    for iteration in iterations:
        indptr.append(indptr[-1] + len(iteration))
    booster = learner["gradient_booster"]["model"]
    booster["trees"] = [{**tree, "id": place} for place, (_, tree) in enumerate(placed)]
    booster["tree_info"] = [channel for channel, _ in placed]
    booster["iteration_indptr"] = indptr
    booster["gbtree_model_param"]["num_trees"] = str(len(placed))
    scores = [_base_score(model["learner"]) for model in models]
    learner["learner_model_param"]["num_target"] = str(len(models))
    learner["learner_model_param"]["base_score"] = "[" + ",".join(scores) + "]"
    learner["attributes"] = {}
    return json.dumps(merged, separators=(",", ":")).encode()


def _trees(model: dict[str, Any]) -> list[dict[str, Any]]:
    trees: list[dict[str, Any]] = model["learner"]["gradient_booster"]["model"]["trees"]
    return trees


def _base_score(learner: dict[str, Any]) -> str:
    """The single base score as XGBoost wrote it: newer versions put it in brackets."""
    text: str = learner["learner_model_param"]["base_score"]
    return text.strip("[]")


def _check_alike(number: int, first: dict[str, Any], other: dict[str, Any]) -> None:
    for what, ours, theirs in (
        ("booster", first["gradient_booster"]["name"], other["gradient_booster"]["name"]),
        ("objective", first["objective"]["name"], other["objective"]["name"]),
        (
            "number of features",
            first["learner_model_param"]["num_feature"],
            other["learner_model_param"]["num_feature"],
        ),
    ):
        if ours != theirs:
            raise ArtifactError(
                f"model {number} has {what} {theirs}, model 0 has {ours}: cannot merge them"
            )
