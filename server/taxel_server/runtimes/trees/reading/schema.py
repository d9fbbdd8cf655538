"""The parts of XGBoost's JSON model schema (version 3) that are read; other parts are skipped.

The schema is documented at https://xgboost.readthedocs.io/en/stable/tutorials/saving_model.html.
"""

from typing import Annotated, Literal

from msgspec import Meta, Raw, Struct

Int32 = Annotated[int, Meta(ge=-(2**31), le=2**31 - 1)]
Count = Annotated[str, Meta(pattern="^[1-9][0-9]{0,9}$")]
"""Sizes are written as text."""


class TreeParam(Struct, gc=False):
    """Sizes of one tree; a leaf vector longer than 1 means several outputs a tree."""

    num_nodes: Count
    size_leaf_vector: Literal["0", "1"]


class Tree(Struct, gc=False):
    """One tree, its nodes in parallel arrays; a leaf has child -1 and its value in `split_conditions`.

    `split_conditions` stay text: they are decimals that have to be rounded once, to float32.
    """

    tree_param: TreeParam
    left_children: list[Int32]
    right_children: list[Int32]
    split_indices: list[Int32]
    split_conditions: Raw
    default_left: list[Int32]
    split_type: list[Int32]


class Trees(Struct):
    """The trees and the output that each adds to."""

    trees: Annotated[list[Tree], Meta(min_length=1)]
    tree_info: list[Int32]


class GradientBooster(Struct):
    """Boosted trees without dropout."""

    name: Literal["gbtree"]
    model: Trees


class Objective(Struct):
    """Objectives whose link is the identity: the sum of the leaves is the prediction."""

    name: Literal["reg:squarederror", "reg:absoluteerror"]


class LearnerParam(Struct):
    """Sizes of the whole model; `base_score` is a number or, from version 3.1 on, `[…]`."""

    base_score: str
    num_class: Literal["0"]
    num_feature: Count
    num_target: Count = "1"


class Learner(Struct):
    """The part of the file that predicts."""

    gradient_booster: GradientBooster
    learner_model_param: LearnerParam
    objective: Objective


class Model(Struct):
    """The whole file."""

    learner: Learner


class Named(Struct):
    """Whatever has a name."""

    name: str


class NamedParts(Struct):
    """The names that explain why the rest of a file is not as expected."""

    gradient_booster: Named
    objective: Named


class NamedModel(Struct):
    """The names of the parts of a whole file."""

    learner: NamedParts
