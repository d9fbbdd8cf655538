"""The queries that a client cycles through, encoded before the run."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.manifest import Manifest
from taxel.protocol import pack_infer_request

_DISTINCT_QUERIES: Final = 64
_DISTINCT_SAMPLES: Final = 65_536
"""At most so many different ones."""


def encoded_queries(manifest: Manifest, samples: int, seed: int, client: int) -> list[bytes]:
    """Infer requests of so many windows each, drawn as the model's training inputs are distributed.

    Each client draws its own.
    """
    distinct = max(1, min(_DISTINCT_QUERIES, _DISTINCT_SAMPLES // samples))
    statistics = manifest.normalisation
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(client,)))
    shape = distinct, samples, len(statistics.input_mean)
    draws: NDArray[np.float64] = generator.standard_normal(shape)
    windows = (draws * statistics.input_std + statistics.input_mean).astype(np.float32)
    return [pack_infer_request(query) for query in windows]
