"""Rollouts in this process: environments in a batch, their simulation, and the evaluation of policies.

What runs an episode belongs here. What decides on runs, or stores them, belongs to `runs`.
"""
