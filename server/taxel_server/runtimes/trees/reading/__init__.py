"""Reads a forest from a model file."""
