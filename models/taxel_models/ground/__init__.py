"""Grounds of the recovery benchmark: clean recordings and a model that was not trained on them."""
