"""Counts a model's arithmetic operations by a rule, one for graphs and one for trees."""
