"""Model-based training: the learnt dynamics model, the user's priors, model rollouts and policy updates."""
