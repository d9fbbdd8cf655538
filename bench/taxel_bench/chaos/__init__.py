"""Faults against a live server, and what must be true meanwhile and afterwards."""
