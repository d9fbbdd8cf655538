"""Operation counts against closed forms."""

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper
from torch import nn

from taxel.errors import ArtifactError
from taxel.windows import WindowSpec
from taxel_bench.operations.of_graph import count_graph_operations
from taxel_bench.operations.of_network import count_network_operations
from taxel_bench.operations.of_trees import count_tree_operations, leaf_depths
from taxel_models.families.networks.network import NetworkFamily, Shape
from taxel_models.families.published import published_mflops
from taxel_models.families.registry import family, resolve


def model(nodes: list[onnx.NodeProto], columns: int, **constants: tuple[int, ...]) -> onnx.ModelProto:
    graph = helper.make_graph(
        nodes,
        "test",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, ["n", columns])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, ["n", None])],
        [
            helper.make_tensor(name, TensorProto.FLOAT, shape, np.ones(int(np.prod(shape))))
            for name, shape in constants.items()
        ],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)])


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("bias", [False, True])
def test_dense_layers_cost_two_operations_a_weight(transposed: bool, bias: bool) -> None:
    weights = (7, 5) if transposed else (5, 7)
    nodes = [
        helper.make_node("Gemm", ["x", "w", "b"] if bias else ["x", "w"], ["h"], transB=int(transposed)),
        helper.make_node("Relu", ["h"], ["r"]),
        helper.make_node("MatMul", ["r", "v"], ["y"]),
    ]
    counted = count_graph_operations(model(nodes, 5, w=weights, b=(7,), v=(7, 3)))
    assert counted == 2 * 5 * 7 + 7 * bias + 7 + 2 * 7 * 3


def test_moving_values_costs_nothing_and_normalising_what_the_rule_says() -> None:
    nodes = [
        helper.make_node("Transpose", ["x"], ["t"], perm=[1, 0]),
        helper.make_node("Transpose", ["t"], ["u"], perm=[1, 0]),
        helper.make_node("LayerNormalization", ["u", "w"], ["l"]),
        helper.make_node("Softmax", ["l"], ["s"]),
        helper.make_node("Sum", ["s", "x", "u"], ["m"]),
        helper.make_node("ReduceSum", ["m"], ["y"]),
    ]
    assert count_graph_operations(model(nodes, 6, w=(6,))) == 6 * (7 + 5 + 3 + 1)


def test_an_operator_without_a_rule_is_named() -> None:
    with pytest.raises(ArtifactError, match="Cos"):
        count_graph_operations(model([helper.make_node("Cos", ["x"], ["y"])], 4))


@pytest.mark.parametrize("combination", [1, 3, 4, 5, 7, 8])
@pytest.mark.parametrize("name", ["network-b", "ffnn", "transformer"])
def test_networks_cost_what_was_published(name: str, combination: int) -> None:
    kind = family(name)
    assert isinstance(kind, NetworkFamily)
    spec = WindowSpec.of(combination)
    shape = Shape(spec, kind.extras, 21)
    network = kind.build(shape, resolve(kind, combination, {}))
    counted = count_network_operations(network, shape.columns)
    assert counted / 1e6 == pytest.approx(published_mflops(name, combination), rel=0.03)


def test_each_part_of_a_network_costs_what_the_rule_says() -> None:
    network = nn.Sequential(
        nn.Linear(5, 7), nn.ELU(), nn.LayerNorm(7), nn.Softmax(dim=-1), nn.Linear(7, 3, bias=False)
    )
    assert count_network_operations(network, 5) == 7 * (2 * 5 + 1) + 7 + 7 * 7 + 5 * 7 + 3 * 2 * 7
    with pytest.raises(ArtifactError, match="cos"):
        count_network_operations(_Cosine(), 5)


class _Cosine(nn.Module):
    def forward(self, columns: torch.Tensor) -> torch.Tensor:
        return torch.cos(columns)


def test_trees_cost_their_paths_and_an_addition_each() -> None:
    """A stump and a chain of three splits; windows that end at its top, and at its bottom."""
    stump = {"left_children": [1, -1, -1], "right_children": [2, -1, -1]}
    chain = {"left_children": [1, -1, 3, -1, 5, -1, -1], "right_children": [2, -1, 4, -1, 6, -1, -1]}
    depths = [leaf_depths(stump), leaf_depths(chain)]
    assert depths[1].tolist() == [0, 1, 1, 2, 2, 3, 3]
    leaves = np.array([[1, 1], [2, 6]])
    assert count_tree_operations(depths, leaves) == 1 + (1 + 3) / 2 + 2
