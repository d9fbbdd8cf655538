"""What all code that numba compiles has in common: vectors, plans of arrays, kernels."""
