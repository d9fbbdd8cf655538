"""Runs in an environment with `taxel[server]`: every shipped model, in process and over zenoh."""

import json
import sys

import numpy as np

import taxel
from taxel_bench.server_process import running_server
from taxel_models.shipped import shipped_repository

TRAINING = ("torch", "xgboost", "pandas", "scipy", "matplotlib")

repository = shipped_repository()
assert sys.prefix in str(repository), f"{repository}: expected a folder in {sys.prefix}"
assert sys.prefix in taxel.__file__, f"{taxel.__file__}: expected a file in {sys.prefix}"
served = {}
with (
    running_server(repository) as endpoint,
    taxel.connect(endpoint) as server,
    taxel.load(repository) as local,
):
    for model in local.models():
        assert model.state == "READY", f"{model.name}: {model.reason}"
        predictor, remote = local.predictor(model.name), server.predictor(model.name)
        rng = np.random.default_rng(0)
        windows = rng.normal(size=(3, len(predictor.manifest.typical_window))).astype(np.float32)
        predicted = predictor.predict(windows)
        assert predicted.shape == (3, len(taxel.CHANNELS)), predicted.shape
        # Each may evaluate a network in another of two ways: export allows them to differ by so much.
        far = np.abs(remote.predict(windows) - predicted).max()
        allowed = 0 if model.platform == "xgboost_json" else predictor.manifest.parity.tolerance
        assert far <= allowed, f"{model.name}: {far} counts apart, allowed {allowed}"
        served[model.name] = predicted.mean().item()
assert served, "no shipped model"
loaded = [name for name in TRAINING if name in sys.modules]
assert not loaded, f"serving loaded {', '.join(loaded)}"
print(json.dumps(served))
