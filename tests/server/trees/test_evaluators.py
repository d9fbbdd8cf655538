"""Every evaluator by itself, for numbers of rows that it would not be chosen for too."""

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from taxel.manifest import Normalisation
from taxel_bench.forests import ForestShape, write_forest
from taxel_server.runtimes.compiled.evaluator import Evaluator
from taxel_server.runtimes.trees.autotune import Autotuned, Timed
from taxel_server.runtimes.trees.few_rows import leaf_blocks, small_batch
from taxel_server.runtimes.trees.few_rows.leaf_blocks import LeafBlocksEvaluator
from taxel_server.runtimes.trees.few_rows.small_batch import SmallBatchEvaluator
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.layout.tree_lanes import BLOCK_LEAVES, MOST_EXITS, count_blocks
from taxel_server.runtimes.trees.many_rows.bitset import BitsetEvaluator
from taxel_server.runtimes.trees.node_walk import walk
from taxel_server.runtimes.trees.normalisation import Scales
from taxel_server.runtimes.trees.reading.forest import Forest
from taxel_server.runtimes.trees.reading.xgboost_json import read_forest
from taxel_server.runtimes.trees.switches import ALL_ON

Windows = NDArray[np.float32]

SHAPES = {
    "even": ForestShape(trees_per_output=13, leaves=30),
    "one leaf or two": ForestShape(outputs=9, trees_per_output=40, leaves=2),
    "more outputs than lanes": ForestShape(outputs=300, trees_per_output=3, leaves=20),
    "many small trees": ForestShape(outputs=5, trees_per_output=900, leaves=9, skew=0.5),
    "mixed sizes": ForestShape(features=20, trees_per_output=6, leaves=130, depth=12),
    "skewed": ForestShape(trees_per_output=2, leaves=400, depth=64, skew=0.5),
    "chains": ForestShape(trees_per_output=2, leaves=200, depth=300, skew=1.0),
    "more leaf blocks than a byte counts": ForestShape(trees_per_output=2, leaves=1500, depth=20),
    "leaf numbers of one byte and of two": ForestShape(trees_per_output=9, leaves=256, depth=30, skew=0.2),
    "comparisons beyond 16 bits": ForestShape(
        features=40, outputs=2, trees_per_output=600, leaves=90, cuts=2500
    ),
    "many columns": ForestShape(features=72, outputs=3, trees_per_output=90, leaves=110, cuts=600),
}

BITSETS = ["bitset-64", "bitset-256"]
EVERY = ["leaf-blocks", "small-batch", *BITSETS]
LARGE = ["leaf-blocks", *BITSETS]
NO_LOOK_UP = ["node-walk", *BITSETS]

NAMES = {
    "even": EVERY,
    "one leaf or two": EVERY,
    "more outputs than lanes": ["node-walk", "small-batch", *BITSETS],
    "many small trees": EVERY,
    "comparisons beyond 16 bits": NO_LOOK_UP,
}
"""The evaluators of some shapes; the others' trees are too large for one of them."""


def check(folder: Path, shape: ForestShape, names: list[str], rows: tuple[int, ...]) -> None:
    path = folder / "model.json"
    write_forest(path, shape, seed=2)
    check_file(path, shape, names, rows)


def check_file(path: Path, shape: ForestShape, names: list[str], rows: tuple[int, ...]) -> None:
    forest = read_forest(path)
    generator = np.random.default_rng(1)
    scales = Scales.of(
        Normalisation(
            input_mean=tuple(generator.normal(size=shape.features)),
            input_std=tuple(generator.uniform(0.5, 2.0, size=shape.features)),
            output_mean=tuple(generator.normal(size=shape.outputs)),
            output_std=tuple(generator.uniform(0.5, 2.0, size=shape.outputs)),
        )
    )
    evaluators = Autotuned.of(forest, scales).evaluators
    assert [evaluator.name for evaluator in evaluators] == names
    for evaluator in evaluators:
        for count in rows:
            windows = generator.normal(size=(count, shape.features)).astype(np.float32)
            windows[generator.random(windows.shape) < 0.05] = np.nan
            result = np.full((count, shape.outputs), np.nan, dtype=np.float32)
            evaluator.evaluate(windows, result)
            np.testing.assert_array_equal(
                result.view(np.int32), walk(forest, scales, windows).view(np.int32)
            )


SWITCHES = tuple(field.name for field in dataclasses.fields(ALL_ON))
WITHOUT_AN_EVALUATOR = {
    "leaf_blocks": ["node-walk", "small-batch", *BITSETS],
    "small_batch": LARGE,
    "bitset_64": ["leaf-blocks", "small-batch", "bitset-256"],
    "bitset_256": ["leaf-blocks", "small-batch", "bitset-64"],
}


@pytest.mark.parametrize("shape", ["even", "mixed sizes"])
@pytest.mark.parametrize("switch", SWITCHES)
def test_without_a_part_the_bits_are_the_same(tmp_path: Path, switch: str, shape: str) -> None:
    evaluated, forest, scales = laid_out(tmp_path, shape, switch)
    all_names = NAMES.get(shape, LARGE)
    expected = [
        name for name in WITHOUT_AN_EVALUATOR.get(switch, EVERY) if name in [*all_names, "node-walk"]
    ]
    assert [each.name for each in evaluated.evaluators] == expected
    windows = np.random.default_rng(0).normal(size=(330, forest.features)).astype(np.float32)
    for rows in (1, 8, 70, 330):
        found = np.empty((rows, len(forest.base_score)), np.float32)
        evaluated.evaluate(windows[:rows], found)
        np.testing.assert_array_equal(found, walk(forest, scales, windows[:rows]))


@pytest.mark.parametrize("switch", [name for name in SWITCHES if name not in WITHOUT_AN_EVALUATOR])
def test_a_switch_changes_what_it_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, switch: str
) -> None:
    for module in (leaf_blocks, small_batch):
        monkeypatch.setattr(module, "waits_for_memory", lambda: True)
    with_it, without = (
        parts(laid_out(tmp_path, "even", name)[0].evaluators, switch) for name in ("", switch)
    )
    assert all(one != other for one, other in zip(with_it, without, strict=True)), (with_it, without)


def parts(evaluators: list[Any], switch: str) -> list[Any]:
    """What a switch decides, in each evaluator that it concerns: a compiled function or a layout."""
    few, small = (evaluator._given[1] for evaluator in evaluators[:2])
    bitset = evaluators[2]._data[0]
    return {
        # Distances within a small batch's trees are too large for packed nodes here.
        "packed_nodes": [few.traversal],
        "next_nodes": [few.prefetches, small.traversal],
        "next_leaves": [few.addition, small.addition],
        "upper_levels": [bitset.narrow.upper],
        "byte_tables": [bitset.leaves["kind"].tolist()],
    }[switch]


def laid_out(folder: Path, shape: str, without: str) -> tuple[Autotuned, Forest, Scales]:
    """A forest with everything on, or without one switch."""
    path = folder / "model.json"
    write_forest(path, SHAPES[shape], seed=2)
    forest = read_forest(path)
    ones = np.ones(max(forest.features, len(forest.base_score)), np.float32)
    scales = Scales(False, ones, ones, ones, ones)
    switches = dataclasses.replace(ALL_ON, **{without: False}) if without else ALL_ON
    return Autotuned.of(forest, scales, switches), forest, scales


@pytest.mark.parametrize("shape", SHAPES)
def test_every_evaluator_gives_the_bits_of_the_node_walk(tmp_path: Path, shape: str) -> None:
    check(tmp_path, SHAPES[shape], NAMES.get(shape, LARGE), (0, 1, 3, 8, 9, 21, 64, 65, 256, 300))


@pytest.mark.parametrize("shape", ["even", "chains", "many small trees"])
def test_what_saves_memory_gives_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shape: str
) -> None:
    for module in (leaf_blocks, small_batch):
        monkeypatch.setattr(module, "waits_for_memory", lambda: True)
    check(tmp_path, SHAPES[shape], NAMES.get(shape, LARGE), (1, 3, 9))


def test_chains_to_the_right_have_small_distances_and_many_blocks(tmp_path: Path) -> None:
    path, shape = tmp_path / "model.json", SHAPES["chains"]
    write_forest(path, dataclasses.replace(shape, leaves=1500, depth=2000), seed=2)
    model = json.loads(path.read_text())
    for tree in model["learner"]["gradient_booster"]["model"]["trees"]:
        node = 0
        while tree["left_children"][node] >= 0:
            children = tree["left_children"][node], tree["right_children"][node]
            leaf, node = sorted(children, key=lambda child: tree["left_children"][child] >= 0)
            parent = tree["parents"][node]
            tree["left_children"][parent], tree["right_children"][parent] = leaf, node
    path.write_text(json.dumps(model))
    assert count_blocks(InOrder.of(read_forest(path)), BLOCK_LEAVES).max() > MOST_EXITS[8]
    check_file(path, shape, LARGE, (1, 9, 64))


@pytest.mark.long
def test_lesser_processors_give_the_same_bits(tmp_path: Path, lesser_processor: Any) -> None:
    looks_up = lesser_processor.name != "SSE2"
    complaints = lesser_processor.complaints(f"""
import importlib.util, pathlib
spec = importlib.util.spec_from_file_location("checks", {str(Path(__file__))!r})
checks = importlib.util.module_from_spec(spec)
spec.loader.exec_module(checks)
folder = pathlib.Path({str(tmp_path)!r})
for shape, names in (("mixed sizes", checks.LARGE), ("even", checks.EVERY)):
    checks.check(folder, checks.SHAPES[shape], names if {looks_up} else checks.NO_LOOK_UP, (1, 9, 70, 300))
""")
    assert complaints == ""


def test_top_trees_that_would_fill_the_memory_are_not_laid_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leaf_blocks, "_MOST_BYTES", 1000)
    check(tmp_path, SHAPES["even"], ["node-walk", *EVERY[1:]], (1,))
    check(tmp_path, SHAPES["skewed"], NO_LOOK_UP, (1,))


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (LeafBlocksEvaluator, "leaf-blocks"),
        (SmallBatchEvaluator, "small-batch"),
        (BitsetEvaluator, "bitset-64"),
    ],
)
def test_an_evaluator_with_other_bits_is_not_used(
    kind: Any, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    original = kind.evaluate

    def one_bit_off(self: Evaluator, windows: Windows, result: Windows) -> None:
        original(self, windows, result)
        result[-1, -1] = np.nextafter(result[-1, -1], np.float32(np.inf))

    monkeypatch.setattr(kind, "evaluate", one_bit_off)
    path = tmp_path / "model.json"
    write_forest(path, SHAPES["even"], seed=2)
    forest = read_forest(path)
    ones = np.ones(max(forest.features, len(forest.base_score)), np.float32)
    scales = Scales(False, ones, ones, ones, ones)
    chosen = Autotuned.of(forest, scales)
    assert f"{name} does not agree" in caplog.text
    assert name not in [evaluator.name for evaluator in chosen.evaluators]
    windows = np.random.default_rng(0).normal(size=(70, forest.features)).astype(np.float32)
    found = np.empty((70, len(forest.base_score)), np.float32)
    chosen.evaluate(windows, found)
    np.testing.assert_array_equal(found, walk(forest, scales, windows))


class Noted:
    """An evaluator that notes what it is given, the rows' own numbers."""

    name = "noted"

    def __init__(self, notes: list[tuple[int, int, int]], place: int) -> None:
        self._notes = notes
        self._place = place

    def evaluate(self, windows: Windows, result: Windows) -> None:
        assert len(windows) == len(result)
        if len(windows):
            self._notes.append((self._place, int(windows[0, 0]), int(windows[-1, 0])))


def chosen_for(rows: int, *sizes: tuple[int, float, float]) -> list[tuple[int, int, int]]:
    """For every evaluation the evaluator's place, its first and last row; each has a size and two times."""
    notes: list[tuple[int, int, int]] = []
    timed = [Timed(Noted(notes, place), *given) for place, given in enumerate(sizes)]
    windows = np.arange(rows, dtype=np.float32)[:, None]
    Autotuned(timed).evaluate(windows, windows.copy())
    return notes


def test_fewer_rows_take_the_first_evaluator_and_many_the_last() -> None:
    sizes = ((8, 1.0, 1.0), (64, 3.0, 3.0), (256, 7.0, 7.0))
    assert chosen_for(8, *sizes) == [(0, 0, 7)]
    assert chosen_for(64, *sizes) == [(1, 0, 63)]
    assert chosen_for(200, *sizes) == [(2, 0, 199)]
    assert chosen_for(512, *sizes) == [(2, 0, 511)]
    assert chosen_for(600, *sizes) == [(2, 0, 511), (1, 512, 599)]
    assert chosen_for(0, *sizes) == []
    assert chosen_for(900, (1, 1.0, 1.0)) == [(0, 0, 899)]


def test_one_row_takes_the_first_evaluator_where_eight_would_not() -> None:
    sizes = ((8, 1.0, 8.0), (64, 3.5, 3.5), (256, 7.0, 7.0))
    assert [chosen_for(rows, *sizes)[0][0] for rows in (1, 2, 3, 4, 8, 9)] == [0, 0, 0, 1, 1, 1]


@pytest.mark.long
@pytest.mark.skipif(os.uname().machine != "x86_64", reason="names x86 processors")
def test_code_for_greater_processors_compiles() -> None:
    # It is not run: the processor at hand may not have the instructions.
    code = """
from taxel_server.runtimes.trees.few_rows import kernels
from taxel_server.runtimes.trees.many_rows import leaf_sums, traversal
from taxel_server.runtimes.compiled.processor import instruction_set, register_bytes
assert (register_bytes(), instruction_set()) == (64, "avx512-vbmi")
kinds = ((8, True), (8, False), (16, False))
assert all(kernels.find_exits(columns, *kind, True) for columns in (16, 48, 128, 256) for kind in kinds)
assert all(kernels.add_blocks(columns, True) for columns in (16, 48, 128, 256))
assert kernels.find_blocks(8) and kernels.find_blocks(16)
assert kernels.put_exits() and kernels.add_leaves(True)
assert all(traversal.find_exits(size, rows) for size in (1, 2) for rows in (64, 256))
assert leaf_sums.add_leaves(64)
"""
    features = "+ssse3,+avx,+avx2,+avx512f,+avx512bw,+avx512vl,+avx512dq,+avx512vbmi"
    greater = {"NUMBA_CPU_NAME": "icelake-server", "NUMBA_CPU_FEATURES": features}
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | greater, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
