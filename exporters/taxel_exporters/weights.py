"""The datatypes of a model file's weights."""

from enum import StrEnum


class Weights(StrEnum):
    """Datatype of an artifact's weights, as it is chosen at export."""

    FLOAT32 = "float32"
    INT8 = "int8"
