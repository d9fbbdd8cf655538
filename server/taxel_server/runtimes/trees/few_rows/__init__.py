"""Evaluates few rows: every lane of a vector is a tree."""
