"""The compiled tick as a C library, made from the kernels that run in Python."""
