"""Lays a forest out in memory, as its evaluators read it."""
