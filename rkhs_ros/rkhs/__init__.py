"""The space: kernels, functions, the Newton basis and kernel matching pursuit."""
