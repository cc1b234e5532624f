"""Studies of many runs: grids, comparisons, statistics over runs, and the workers that execute them."""
