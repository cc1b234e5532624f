"""Policy search from episodes: the training loop, the algorithms and model-based training."""
