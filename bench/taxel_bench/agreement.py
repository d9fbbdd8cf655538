"""Whether all engines give the same counts: speed is only compared between equal answers."""

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import TaxelError
from taxel_bench.engines import Engine
from taxel_bench.subjects import Subject


def largest_differences(subject: Subject, windows: NDArray[np.float32]) -> dict[str, float | None]:
    """Largest difference of each other engine's counts from ours; None where they are not compared.

    Args:
        windows: (n, f) raw; all are evaluated in one call.

    Raises:
        TaxelError: an engine differs by more than its tolerance: no figure may be printed.
    """
    counts = subject.taxel.predict(windows).astype(np.float64)
    std = np.asarray(subject.manifest.normalisation.output_std)
    return {
        engine.name: _difference(subject.model, engine, windows, counts, std)
        for engine in subject.engines
        if engine is not subject.taxel
    }


def _difference(
    model: str,
    engine: Engine,
    windows: NDArray[np.float32],
    counts: NDArray[np.float64],
    std: NDArray[np.float64],
) -> float | None:
    if engine.tolerance is None:
        return None
    differences = np.abs(counts - engine.predict(windows))
    allowed = engine.tolerance * std
    if not (differences <= allowed).all():
        row, column = np.unravel_index(int(np.argmax(np.nan_to_num(differences, nan=np.inf))), counts.shape)
        raise TaxelError(
            f"{model}: the engine {engine.name} differs from ours by {differences[row, column]:g} counts "
            f"on channel {CHANNELS[column]}: expected at most {allowed[column]:g}, so their speed is not "
            "compared"
        )
    return float(differences.max())
