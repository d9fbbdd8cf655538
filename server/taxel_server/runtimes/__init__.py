"""Runtimes: each evaluates the artifacts of one platform."""

from taxel_server.runtimes.runtime import Runtime, open_runtime

__all__ = ["Runtime", "open_runtime"]
