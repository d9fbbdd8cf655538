"""Runtimes: each evaluates the artifacts of one platform."""

from taxel_server.runtimes.evaluator_info import EvaluatorInfo
from taxel_server.runtimes.options import DEFAULTS, RuntimeOptions
from taxel_server.runtimes.runtime import Runtime, check_platform, open_runtime

__all__ = ["DEFAULTS", "EvaluatorInfo", "Runtime", "RuntimeOptions", "check_platform", "open_runtime"]
