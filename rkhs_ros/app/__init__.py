"""The command line, a module for each command, and the launcher of a run's nodes."""
