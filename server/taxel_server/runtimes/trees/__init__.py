"""XGBoost forests, evaluated without XGBoost: parse, lay out, traverse."""

from taxel_server.runtimes.trees.runtime import TreesRuntime

__all__ = ["TreesRuntime"]
