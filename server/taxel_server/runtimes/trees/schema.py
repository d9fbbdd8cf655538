"""What of XGBoost's JSON model schema (version 3) we read, with numeric arrays already set aside.

The schema is documented at https://xgboost.readthedocs.io/en/stable/tutorials/saving_model.html.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StrictInt
from typing_extensions import TypedDict

Array = tuple[StrictInt]
"""A numeric array: its place among the arrays that the scanner set aside."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True)


class TreeParam(TypedDict):
    """Sizes of one tree; a leaf vector longer than 1 means several outputs a tree."""

    num_nodes: Annotated[int, Field(gt=0)]
    size_leaf_vector: Literal["0", "1"]


class Tree(TypedDict):
    """One tree, its nodes in parallel arrays; a leaf has child -1 and its value in `split_conditions`.

    There are tens of thousands of them: as dictionaries they need a fourth of the memory.
    """

    tree_param: TreeParam
    left_children: Array
    right_children: Array
    split_indices: Array
    split_conditions: Array
    default_left: Array
    split_type: Array


class Trees(_Part):
    """The trees and the output that each adds to."""

    trees: Annotated[list[Tree], Field(min_length=1)]
    tree_info: Array


class GradientBooster(_Part):
    """Boosted trees without dropout."""

    name: Literal["gbtree"]
    model: Trees


class Objective(_Part):
    """Objectives whose link is the identity: the sum of the leaves is the prediction."""

    name: Literal["reg:squarederror", "reg:absoluteerror"]


class LearnerParam(_Part):
    """Sizes of the whole model; `base_score` is a number or, from version 3.1 on, `[…]`."""

    base_score: str
    num_class: Literal["0"]
    num_feature: Annotated[int, Field(gt=0)]
    num_target: Annotated[int, Field(gt=0)] = 1


class Learner(_Part):
    """The part of the file that predicts."""

    gradient_booster: GradientBooster
    learner_model_param: LearnerParam
    objective: Objective


class Model(_Part):
    """The whole file."""

    learner: Learner
