"""Hyperparameter search with SMAC3 in the paper's search spaces."""
