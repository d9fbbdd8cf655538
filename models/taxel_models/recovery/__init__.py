"""Recovery: known effects are injected into recordings, and the loop has to find them without knowing."""
