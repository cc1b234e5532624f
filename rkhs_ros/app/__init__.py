"""The command line, and the launcher of a run's nodes."""
