"""The twin: a seeded simulation of one BioTac 2P fingertip, for machines without a recording."""

from taxel_models.twin.simulation import perform, simulate

__all__ = ["perform", "simulate"]
