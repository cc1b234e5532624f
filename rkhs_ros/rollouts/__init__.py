"""Rollouts in this process: environments in a batch, their simulation, and the evaluation of policies.

This package runs episodes. `runs` manages and stores runs.
"""
