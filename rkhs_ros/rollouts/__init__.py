"""Rollouts in this process: environments in a batch, their simulation, and the evaluation of policies."""
