"""Versions that are loaded again and again while a control loop asks: what loop and memory notice."""
