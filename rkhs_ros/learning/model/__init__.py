"""The learnt dynamics model: the user's priors, posteriors of changes, rewards and ends, and model rollouts."""
