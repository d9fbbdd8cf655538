"""Effects: nameable causes of structure in a residual, each in its own file."""
