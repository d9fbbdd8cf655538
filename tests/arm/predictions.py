"""The shipped models' predictions: written on one processor, compared on another.

    python tests/arm/predictions.py write FILE
    python tests/arm/predictions.py compare FILE

A forest's have to be the same bits. A network's sums may be rounded otherwise; they have to be as near to
ONNX Runtime's as the server asks for. A network's program is compared even where a load would choose
ONNX Runtime.
"""

import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from taxel import artifacts
from taxel.artifacts import Artifact
from taxel_server.runtimes import Runtime, open_runtime
from taxel_server.runtimes.networks.graph import read_graph
from taxel_server.runtimes.networks.lowering import lower
from taxel_server.runtimes.networks.runtime import ProgramEvaluator

SHIPPED: Final = Path(__file__).parents[2] / "models" / "repository"
ROWS: Final = (*[1] * 40, 2, 8, 9, 64, 256, 300)
MOST_APART: Final = 1e-4
"""Of a channel's deviation, for networks."""


def windows_of(artifact: Artifact) -> NDArray[np.float32]:
    """As many as all `ROWS`."""
    statistics = artifact.manifest.normalisation
    draws = np.random.default_rng(0).normal(size=(sum(ROWS), len(statistics.input_mean)))
    return (draws * statistics.input_std + statistics.input_mean).astype(np.float32)


def predict(runtime: Runtime, windows: NDArray[np.float32]) -> NDArray[np.float32]:
    """So many `ROWS` at once."""
    parts = np.split(windows, np.cumsum(ROWS)[:-1])
    return np.concatenate([runtime.evaluate(np.ascontiguousarray(part)) for part in parts])


def compare(artifact: Artifact, expected: NDArray[np.float32]) -> bool:
    """Prints how far this processor's predictions are from another's; whether that is near enough."""
    runtime, windows = open_runtime(artifact), windows_of(artifact)
    found = predict(runtime, windows)
    used = ", ".join(dict.fromkeys(runtime.evaluator(rows).name for rows in ROWS))
    print(f"{artifact.manifest.name}: {found.size} values by {used}", flush=True)
    if artifact.manifest.platform == "xgboost_json":
        others = int((found.view(np.int32) != expected.view(np.int32)).sum())
        print(f"  {others} have other bits than on the other processor")
        return others == 0
    session = onnxruntime.InferenceSession(artifact.model_path)
    by_onnx_runtime = session.run(None, {session.get_inputs()[0].name: windows})[0]
    deviations = np.array(artifact.manifest.normalisation.output_std)
    program = ProgramEvaluator(lower(read_graph(artifact.model_path)))
    near = []
    for name, counts in (("as loaded", found), (program.name, program.counts(windows))):
        others = (by_onnx_runtime, expected)
        apart = [float((np.abs(counts - other) / deviations).max()) for other in others]
        print(
            f"  {name}: at most {apart[0]:.1e} of a channel's deviation from ONNX Runtime's"
            f" on this processor, {apart[1]:.1e} from the other processor's"
        )
        near.append(max(apart) <= MOST_APART)
    return all(near)


def main(action: str, file: str) -> int:
    """Writes or compares all shipped models' predictions."""
    models = [artifacts.read(folder) for folder in sorted(SHIPPED.glob("*/*"))]
    if action == "write":
        predictions: dict[str, Any] = {
            model.manifest.name: predict(open_runtime(model), windows_of(model)) for model in models
        }
        np.savez(file, **predictions)
        return 0
    with np.load(file) as expected:
        near = [compare(model, expected[model.manifest.name]) for model in models]
    return int(not all(near))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
