"""XGBoost forests, evaluated without XGBoost: parse, lay out, traverse."""

from taxel_server.runtimes.trees.runtime import TreesRuntime, open_artifact

__all__ = ["TreesRuntime", "open_artifact"]
