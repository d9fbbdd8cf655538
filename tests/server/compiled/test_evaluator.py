"""What evaluators of every kind have in common."""

from pathlib import Path

import numpy as np
import pytest

from taxel import artifacts
from taxel_server.runtimes import open_runtime
from taxel_server.runtimes.compiled.evaluator import CompiledEvaluator
from taxel_server.runtimes.networks import NetworkRuntime
from taxel_server.runtimes.trees import TreesRuntime

SHIPPED = Path(__file__).parents[3] / "models" / "repository"


def evaluators(name: str) -> list[CompiledEvaluator]:
    opened = open_runtime(artifacts.read(SHIPPED / name / "1"))
    if isinstance(opened, NetworkRuntime):
        return [opened._program]
    assert isinstance(opened, TreesRuntime)
    return [
        evaluator for evaluator in opened._autotuned.evaluators if isinstance(evaluator, CompiledEvaluator)
    ]


@pytest.mark.parametrize("name", ["xgb", "network-b"])
def test_windows_of_bytes_need_no_code_of_their_own(name: str) -> None:
    """A server's first request would wait for seconds, as long as compiling takes."""
    windows = np.ones((3, 12), np.float32)
    read_only, odd = (
        np.frombuffer(bytes(start) + windows.tobytes(), np.float32, offset=start).reshape(3, 12)
        for start in (0, 1)
    )
    assert (read_only.flags.aligned, odd.flags.aligned) == (True, False)
    found = evaluators(name)
    assert found
    for evaluator in found:
        before = evaluator._evaluation.signatures  # type: ignore[attr-defined]
        results = np.empty((3, 3, 21), np.float32)
        for given, result in zip((windows, read_only, odd), results, strict=True):
            evaluator.evaluate(given, result)
        np.testing.assert_array_equal(results, results[:1].repeat(3, axis=0))
        assert windows.flags.writeable
        assert evaluator._evaluation.signatures == before  # type: ignore[attr-defined]
        assert len(before) == 1
