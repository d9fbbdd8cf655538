"""Evaluates many rows: every lane, or bit, of a vector is a row."""
