"""What all code that numba compiles has in common: vectors, kernel arguments, evaluators."""
