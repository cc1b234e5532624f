"""Reproducing kernel Hilbert spaces: kernels, functions, the Newton basis, regression and matching pursuit."""
