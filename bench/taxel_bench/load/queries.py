"""The queries that a client cycles through, encoded before the run."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.manifest import Manifest
from taxel.protocol import pack_infer_request
from taxel_bench.windows import random_windows

_DISTINCT_QUERIES: Final = 64
_DISTINCT_SAMPLES: Final = 65_536
"""At most so many different ones."""


def encoded_queries(manifest: Manifest, samples: int, seed: int, client: int) -> list[bytes]:
    """Infer requests of so many random windows each; each client draws its own."""
    return [pack_infer_request(query) for query in drawn_queries(manifest, samples, seed, client)]


def drawn_queries(manifest: Manifest, samples: int, seed: int, client: int) -> list[NDArray[np.float32]]:
    """The windows (samples, f) of these requests."""
    distinct = max(1, min(_DISTINCT_QUERIES, _DISTINCT_SAMPLES // samples))
    own = np.random.SeedSequence(seed, spawn_key=(client,))
    windows = random_windows(manifest, distinct * samples, own)
    return np.split(windows, distinct)
