"""Model-based training: the learnt dynamics model, its rollouts, the user's priors, and the updates made in it."""
