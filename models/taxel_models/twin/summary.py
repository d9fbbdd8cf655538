"""A few figures that describe a recording of the twin."""

from typing import Final

import numpy as np

from taxel.scaling import Scaler
from taxel_models.recordings import Recording

TOUCHED_N: Final = 0.05
"""Above this force a row counts as touched: five SDs of the force's noise."""


def summarise(recording: Recording) -> dict[str, float]:
    """Share of touched rows, forces, temperature, and the error of the mean predictor.

    `mean_predictor_norm_mae` is the mean absolute z-score over all rows and channels; on the paper's
    data set it is 0.537.
    """
    force = np.linalg.norm(recording.samples.force, axis=1)
    scores = Scaler.fit(recording.channels).normalise(recording.channels.astype(np.float32))
    tdc = recording.auxiliary["tdc"]
    return {
        "touched_share": float((force > TOUCHED_N).mean()),
        "force_p99_n": float(np.quantile(force, 0.99)),
        "force_max_n": float(force.max()),
        "tdc_first": float(tdc[0]),
        "tdc_last": float(tdc[-1]),
        "mean_predictor_norm_mae": float(np.abs(scores).mean()),
    }
