"""What the reader makes of harmless YAML, and what the weights' texts may look like."""

import base64
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from taxel.errors import ArtifactError
from taxel_exporters.gazebo import document
from taxel_exporters.gazebo.document import parse_document
from taxel_exporters.gazebo.weights import decode_matrix, decode_vector

TEXT = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), max_size=12)
TREES = st.recursive(
    TEXT, lambda part: st.lists(part, max_size=4) | st.dictionaries(TEXT, part, max_size=4), max_leaves=20
)
FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)


@pytest.mark.parametrize("parser", ["CSafeLoader", "SafeLoader"])
@given(tree=TREES)
def test_what_was_written_is_read(parser: str, tree: Any) -> None:
    content = yaml.safe_dump(tree, allow_unicode=True).encode()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(document, "_LOADER", getattr(yaml, parser))
        assert parse_document(content, "file") == tree


def test_scalars_stay_texts_and_aliases_are_shared() -> None:
    tree = parse_document(b"{a: &x [1.0e-05, .nan, ~, true], b: *x, c: !!int 3, d: 2001-01-01}", "file")
    assert tree == {
        "a": ["1.0e-05", ".nan", "~", "true"],
        "b": ["1.0e-05", ".nan", "~", "true"],
        "c": "3",
        "d": "2001-01-01",
    }
    assert isinstance(tree, dict)
    assert tree["a"] is tree["b"]


def encoded(values: np.ndarray) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


@given(arrays(np.float32, st.integers(1, 40), elements=FLOATS), st.integers(1, 40))
def test_a_vector_is_read_to_the_bit_and_only_at_its_length(values: np.ndarray, other: int) -> None:
    text = encoded(values)
    for written in (text, base64.b64encode(text.encode()).decode(), "\n".join(text)):
        assert decode_vector(written, len(values), "here").tobytes() == values.tobytes()
    if other != len(values):
        with pytest.raises(ArtifactError, match="here: "):
            decode_vector(text, other, "here")


@given(arrays(np.float32, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=FLOATS))
def test_a_matrix_has_a_row_for_each_input(values: np.ndarray) -> None:
    rows: Any = [encoded(row) for row in values]
    np.testing.assert_array_equal(decode_matrix(rows, *values.shape, "here"), values)
    with pytest.raises(ArtifactError, match=r"here: .* rows: expected"):
        decode_matrix(rows, len(rows) + 1, values.shape[1], "here")
