"""Compares Taxel's server with what a user would pick instead: same model, same windows, one run."""
