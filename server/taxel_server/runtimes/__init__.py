"""Runtimes: each evaluates the artifacts of one platform."""

from taxel_server.runtimes.runtime import DEFAULTS, Runtime, RuntimeOptions, open_runtime

__all__ = ["DEFAULTS", "Runtime", "RuntimeOptions", "open_runtime"]
