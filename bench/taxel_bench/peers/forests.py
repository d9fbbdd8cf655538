"""Peers for forests: XGBoost with one merged booster, ONNX Runtime, Treelite twice, daal4py."""

from importlib.metadata import version
from typing import Any, Final

import numpy as np
import xgboost
from numpy.typing import NDArray

from taxel.errors import Unavailable
from taxel.scaling import Scaler
from taxel_bench.engines import SAME_ANSWERS, THREADS, Engine
from taxel_bench.peers import compiled_treelite
from taxel_bench.peers.onnx_engine import onnx_engine
from taxel_bench.peers.peer import ForestModel, Peer
from taxel_exporters.onnx_trees import forest_onnx


def _on_z_scores(
    model: ForestModel,
    name: str,
    how: str,
    evaluate: Any,
    *,
    prepare: Any = lambda windows: windows,
    stack: Any = np.asarray,
    tolerance: float = SAME_ANSWERS,
) -> Engine:
    """An engine that takes z-scores, as XGBoost's model does; scaling is not timed.

    Args:
        prepare: z-scores (n, f) to what `evaluate` takes; not timed.
        stack: what `evaluate` gives to z-scores (n, 21); not timed.
    """
    manifest = model.artifact.manifest
    statistics = manifest.normalisation
    columns = manifest.window.model_columns
    inputs = Scaler.of(statistics.input_mean, statistics.input_std)
    outputs = Scaler.of(statistics.output_mean, statistics.output_std)
    return Engine(
        name,
        how,
        lambda windows: prepare(inputs.normalise(np.ascontiguousarray(windows[:, :columns]))),
        evaluate,
        lambda result: outputs.restore(stack(result)),
        None,
        tolerance,
    )


def _merged_booster(model: ForestModel) -> Engine:
    booster = xgboost.Booster()
    booster.load_model(model.artifact.model_path)
    # Loading replaces the number of threads.
    booster.set_param({"nthread": THREADS})
    how = f"one Booster.inplace_predict for all channels, XGBoost {xgboost.__version__}"
    return _on_z_scores(model, "xgboost-merged", how, booster.inplace_predict, tolerance=0.0)


def _onnx_runtime(model: ForestModel) -> Engine:
    manifest = model.artifact.manifest
    columns = manifest.window.model_columns
    graph = forest_onnx(model.boosters, manifest.normalisation, columns, columns)
    how = "one TreeEnsembleRegressor, raw windows to counts"
    return onnx_engine("onnxruntime", how, graph, manifest)


def _treelite_gtil(model: ForestModel) -> Engine:
    import treelite
    from treelite import gtil

    forest = treelite.frontend.load_xgboost_model(model.artifact.model_path, format_choice="inspect")
    return _on_z_scores(
        model,
        "treelite-gtil",
        f"gtil.predict, Treelite {treelite.__version__}",
        lambda windows: gtil.predict(forest, windows, nthread=THREADS),
        stack=lambda scores: scores[:, :, 0],
    )


def _treelite_compiled(model: ForestModel) -> Engine:
    import tl2cgen

    library = compiled_treelite.compiled_library(model.artifact, install=model.install)
    predictor = tl2cgen.Predictor(library, nthread=THREADS)
    return _on_z_scores(
        model,
        compiled_treelite.NAME,
        f"C code compiled by gcc -O1, TL2cgen {tl2cgen.__version__}",
        predictor.predict,
        prepare=lambda windows: tl2cgen.DMatrix(windows),
        stack=lambda scores: scores[:, :, 0],
    )


def _daal4py(model: ForestModel) -> Engine:
    import daal4py

    daal4py.daalinit(THREADS)
    try:
        models = [daal4py.mb.convert_model(booster) for booster in model.boosters]
    except (TypeError, ValueError) as error:
        raise Unavailable(f"daal4py cannot read the forest: {error}") from None

    release = version("scikit-learn-intelex")

    def evaluate(windows: NDArray[np.float32]) -> list[NDArray[Any]]:
        return [each.predict(windows) for each in models]

    return _on_z_scores(
        model,
        "daal4py",
        f"{len(models)} x predict, as it reads models of one output, daal4py {release}",
        evaluate,
        stack=lambda columns: np.stack([column.reshape(-1) for column in columns], 1).astype(np.float32),
    )


FOREST_PEERS: Final = (
    Peer[ForestModel]("xgboost-merged", _merged_booster),
    Peer[ForestModel]("onnxruntime", _onnx_runtime),
    Peer[ForestModel]("treelite-gtil", _treelite_gtil, ("treelite==4.8.1",), "treelite"),
    Peer[ForestModel](compiled_treelite.NAME, _treelite_compiled, compiled_treelite.PACKAGES, "tl2cgen"),
    Peer[ForestModel]("daal4py", _daal4py, ("scikit-learn-intelex==2026.2.0",), "daal4py"),
)
