"""The loop: residual, cause, correction, and the error before and after."""
