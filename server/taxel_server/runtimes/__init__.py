"""Runtimes: each evaluates the artifacts of one platform."""

import os

# Or ONNX Runtime looks for a host of its maker to send measurements to, and writes them down in the user's
# cache. It looks for this while it is imported.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

from taxel_server.runtimes.evaluator_info import EvaluatorInfo
from taxel_server.runtimes.options import DEFAULTS, RuntimeOptions
from taxel_server.runtimes.runtime import Runtime, check_platform, open_runtime

__all__ = ["DEFAULTS", "EvaluatorInfo", "Runtime", "RuntimeOptions", "check_platform", "open_runtime"]
