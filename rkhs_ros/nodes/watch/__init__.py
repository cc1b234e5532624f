"""The nodes that watch a run or pass on an operator's decisions: status, monitor, operator, recorder."""
