"""Model families: how each is configured, fitted, kept and evaluated."""
