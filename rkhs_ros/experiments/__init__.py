"""Runs: configuration, the training loop, the in-process runner, reports and the command line."""
