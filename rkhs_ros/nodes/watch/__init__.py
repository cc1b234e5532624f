"""The nodes that observe a run or forward an operator's commands: status, monitor, operator, recorder."""
