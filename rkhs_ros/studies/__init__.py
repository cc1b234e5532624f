"""Many runs: grids, searches, comparisons, statistics over runs, and the workers that make them.

A single run and its folder belong to `runs`.
"""
