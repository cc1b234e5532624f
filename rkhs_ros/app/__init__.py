"""The command line (one module per command), the library functions, and the launcher of a run's nodes."""
