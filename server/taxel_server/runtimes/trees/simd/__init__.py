"""Vector operations of the forest's kernels."""
