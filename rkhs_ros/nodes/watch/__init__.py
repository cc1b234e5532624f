"""The nodes that observe a run or forward an operator's commands: status and operator."""
