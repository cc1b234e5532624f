"""Tasks as Gymnasium environments, simulated robots, and the nodes that serve them over topics."""
