"""A run and its folder: configuration, simulation in process, recording, curve and report."""
