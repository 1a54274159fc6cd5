"""Compiled numerical kernels: arrays in, arrays and status codes out; numpy and numba only."""
