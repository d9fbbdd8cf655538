"""What load clients send."""

from pathlib import Path

import numpy as np

from taxel import artifacts
from taxel.protocol import unpack_infer_request
from taxel_bench.load.queries import encoded_queries


def test_queries_have_every_column_that_a_server_asks_for(corrected: Path) -> None:
    manifest = artifacts.read(corrected).manifest
    queries = encoded_queries(manifest, samples=2000, seed=4, client=0)
    assert len(queries) == 65_536 // 2000
    windows = np.array([unpack_infer_request(query).windows for query in queries])
    assert windows.shape == (32, 2000, 14)
    flat = windows.reshape(-1, 14)
    assert (flat[:, 12:] == [0, 2000]).all()
    statistics = manifest.normalisation
    scores = (flat[:, :12] - statistics.input_mean) / statistics.input_std
    assert np.abs(scores.mean(axis=0)).max() < 0.02
    assert np.abs(scores.std(axis=0) - 1).max() < 0.02


def test_each_client_and_each_seed_has_its_own(corrected: Path) -> None:
    manifest = artifacts.read(corrected).manifest
    told = [encoded_queries(manifest, 1, seed, client) for seed, client in ((0, 0), (0, 0), (0, 1), (1, 0))]
    assert told[0] == told[1]
    assert len({query for queries in told for query in queries}) == 3 * 64
