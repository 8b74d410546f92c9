"""Kernels that numba compiles, apart from the back ends, which are imported with and without numba."""
