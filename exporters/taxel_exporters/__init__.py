"""Exports trained models as artifacts, and checks that both predict the same."""
