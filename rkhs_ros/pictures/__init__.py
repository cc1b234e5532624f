"""Stills and films of runs and policies."""
