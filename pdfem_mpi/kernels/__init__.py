"""Compiled kernels: arrays in, arrays out. The only home of numba."""
