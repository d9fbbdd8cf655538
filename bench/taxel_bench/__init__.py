"""Measures Taxel as its users would: the benchmark's subjects, timing, reports, and the demo."""
