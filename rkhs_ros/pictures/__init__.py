"""Figures and films of runs and policies."""
