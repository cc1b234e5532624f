"""The algorithms, one module each, and their shared parts: critics, step rules and function spaces."""
