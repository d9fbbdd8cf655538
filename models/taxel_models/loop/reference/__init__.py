"""The reference: a model's own held-out residual, which says what the model gets wrong anyway."""
