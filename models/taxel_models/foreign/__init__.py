"""Foreign injectors: causes that share no code with the loop and, but for a few, no equation."""
