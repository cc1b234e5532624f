"""Studies of many runs: grids, comparisons, statistics over runs, and the workers that execute them.

A single run and its folder belong to `runs`.
"""
