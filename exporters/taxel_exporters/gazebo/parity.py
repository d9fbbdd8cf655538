"""Compares an imported artifact with its `model.yaml` on random windows."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import taxel
from taxel.channels import COUNTS_MAX
from taxel.manifest import Parity
from taxel_exporters.agreement import agreement
from taxel_exporters.gazebo.columns import CHANNEL_COLUMNS, FEATURE_COLUMNS, INPUTS, TEMPERATURE
from taxel_exporters.gazebo.network import Network

WINDOWS: Final = 4096

_TOLERANCE: Final = 2e-5
"""The largest difference, relative to the largest value: float32's error over several layers."""

_ROWS: Final = 256


def check_parity(repository: Path, name: str, network: Network) -> Parity:
    """Compare the artifact, as it will be served, with the network evaluated in float64.

    Windows are drawn from the network's own statistics of its inputs. Half of them come with a
    temperature, the others use its default.

    Raises:
        ArtifactError: a prediction differs by more than float32 explains, or a layer overflows.
    """
    rows = _draw(network)
    expected = np.concatenate(
        [
            network.evaluate(rows[start : start + _ROWS].astype(np.float64))
            for start in range(0, WINDOWS, _ROWS)
        ]
    )[:, CHANNEL_COLUMNS]
    windows = rows[:, FEATURE_COLUMNS]
    with taxel.load(repository) as source:
        predictor = source.predictor(name)
        given = predictor.predict(windows[: WINDOWS // 2])
        default = predictor.predict(windows[WINDOWS // 2 :, :-1])
    found = np.concatenate([given, default])
    tolerance = _TOLERANCE * max(COUNTS_MAX, float(np.abs(expected).max()))
    return agreement(found, expected, tolerance, "the network")


def _draw(network: Network) -> NDArray[np.float32]:
    """Rows of `columns.INPUTS`; the second half has the mean temperature, the last is all means."""
    draws = np.random.default_rng(0).normal(size=(WINDOWS, len(INPUTS)))
    draws[WINDOWS // 2 :, INPUTS.index(TEMPERATURE)] = 0.0
    draws[-1] = 0.0
    rows: NDArray[np.float32] = (draws * network.inputs.std + network.inputs.mean).astype(np.float32)
    return rows
