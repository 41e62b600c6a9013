"""Read-only arrays and compiled kernels."""
