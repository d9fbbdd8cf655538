"""Predictions against measurements: errors, tables, plots and files."""
