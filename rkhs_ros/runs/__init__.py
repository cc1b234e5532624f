"""A run and its folder: configuration, simulation in process, recording, checkpoints, curve and report."""
